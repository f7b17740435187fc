"""The commands of the acquisition side, for the entry-point group `dynid.commands`."""

from __future__ import annotations

import typer

from daq.commands import import_file, record, recover

app = typer.Typer()
for command in (record, import_file, recover):
    app.add_typer(command.app)
