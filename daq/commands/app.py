"""The commands of the acquisition side, for the entry-point group `dynid.commands`."""

from __future__ import annotations

import typer

from daq.commands import import_file, record, recover, robots

app = typer.Typer()
for command in (robots, import_file, record, recover):
    app.add_typer(command.app)
