"""The commands of the identification side, for the entry-point group `dynid.commands`."""

from __future__ import annotations

import typer

from ident.commands.identification import bench, compare, fleet, friction, identify, merge, payload, validate
from ident.commands.preparation import check, excite, info, lint, robot, sweep
from ident.commands.use import diff, export, history, monitor, predict

app = typer.Typer()
for command in (
    robot,
    check,
    lint,
    excite,
    sweep,
    info,
    identify,
    validate,
    predict,
    monitor,
    compare,
    bench,
    diff,
    fleet,
    history,
    merge,
    payload,
    friction,
    export,
):
    app.add_typer(command.app)
