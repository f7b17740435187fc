"""The commands of the identification side, for the entry-point group `dynid.commands`."""

from __future__ import annotations

import typer

from ident.commands import (
    bench,
    check,
    compare,
    diff,
    excite,
    export,
    fleet,
    friction,
    history,
    identify,
    info,
    lint,
    merge,
    monitor,
    payload,
    predict,
    robot,
    sweep,
    validate,
)

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
    monitor,
    payload,
    friction,
    export,
):
    app.add_typer(command.app)
