"""The commands of the identification side, for the entry-point group `dynid.commands`."""

from __future__ import annotations

import typer

from ident.commands import check, excite, identify, info, merge, payload, robot, validate

app = typer.Typer()
for command in (robot, check, excite, info, identify, validate, merge, payload):
    app.add_typer(command.app)
