"""The command `dynid validate`."""

from __future__ import annotations

from pathlib import Path

import typer

from ident.commands.options import JSON

app = typer.Typer()


@app.command("validate")
def validate_model(
    result: Path = typer.Argument(help="Folder that identify wrote, or its result.json."),
    recordings: list[Path] = typer.Argument(help="Held-out recordings (.h5), each judged apart."),
    as_json: bool = JSON,
) -> None:
    """Predict the torques of other recordings with a stored model.

    Example: dynid validate model val.h5
    """
    from dataclasses import asdict

    from daq.commands.console import print_json
    from ident.commands.print_result import print_fit, print_verdict
    from ident.tasks.validation import validate

    validation = validate(result, recordings)
    if as_json:
        print_json(
            {
                "result": str(result),
                "joints": list(validation.joints),
                "full": validation.full.model_dump(),
                "essential": validation.essential.model_dump(),
                "verdict": asdict(validation.verdict),
                "recordings": [
                    {
                        "recording": one.recording,
                        "full": one.full.model_dump(),
                        "essential": one.essential.model_dump(),
                        "verdict": asdict(one.verdict),
                    }
                    for one in validation.recordings
                ],
            }
        )
        return
    for one in validation.recordings:
        print(one.recording)
        for name, fit in (("full", one.full), ("essential", one.essential)):
            print_fit(f"{name} model", validation.joints, fit)
        print_verdict(one.verdict)
        print()
    if len(validation.recordings) > 1:
        print(f"All recordings together: {validation.verdict.headline}")
