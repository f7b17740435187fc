"""The command `dynid validate`."""

from __future__ import annotations

from pathlib import Path

import typer

from ident.commands.options import JSON

app = typer.Typer()


@app.command("validate")
def validate(
    result: Path = typer.Argument(help="result.json of an identification."),
    recording: Path = typer.Argument(help="Held-out recording (.h5)."),
    as_json: bool = JSON,
) -> None:
    """Predict another recording's torques with a stored model.

    Example: dynid validate model/result.json val.h5
    """
    from dataclasses import asdict

    from daq.commands.console import print_json
    from daq.recording.reader import read_recording
    from ident.commands.print_result import print_fit
    from ident.identify.revalidate import revalidate
    from ident.result.schema import read_result

    stored = read_result(result)
    figures = revalidate(stored, read_recording(recording))
    if as_json:
        lists = {
            name: {key: getattr(value, "tolist", lambda value=value: value)() for key, value in asdict(part).items()}
            for name, part in (("full", figures.full), ("essential", figures.essential))
        }
        print_json({"result": str(result), "recording": str(recording), "joints": stored.joints, **lists})
        return
    for name, part in (("full", figures.full), ("essential", figures.essential)):
        print(f"{name} model: relative error {part.relative_error * 100:.2f} % over {part.samples} filtered samples")
        print_fit(stored.joints, part)
