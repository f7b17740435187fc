"""The command `dynid validate`."""

from __future__ import annotations

from pathlib import Path

import typer

from ident.commands.options import JSON

app = typer.Typer()


@app.command("validate")
def validate_model(
    result: Path = typer.Argument(help="Folder that identify wrote, or its result.json."),
    recording: Path = typer.Argument(help="Held-out recording (.h5)."),
    as_json: bool = JSON,
) -> None:
    """Predict another recording's torques with a stored model.

    Example: dynid validate model/result.json val.h5
    """
    from daq.commands.console import print_json
    from ident.commands.print_result import print_fit
    from ident.tasks.validation import validate

    validation = validate(result, recording)
    fits = {"full": validation.full, "essential": validation.essential}
    if as_json:
        figures = {name: fit.model_dump() for name, fit in fits.items()}
        print_json({"result": str(result), "recording": str(recording), "joints": list(validation.joints), **figures})
        return
    for name, fit in fits.items():
        print_fit(f"{name} model", validation.joints, fit)
