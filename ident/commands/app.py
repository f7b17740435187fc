"""The commands of the identification side, for the entry-point group `dynid.commands`."""

from __future__ import annotations

import typer

from ident.commands import (
    check,
    compare,
    diff,
    excite,
    export,
    identify,
    info,
    merge,
    payload,
    predict,
    robot,
    sweep,
    validate,
)

app = typer.Typer()
for command in (robot, check, excite, sweep, info, identify, validate, predict, compare, diff, merge, payload, export):
    app.add_typer(command.app)
