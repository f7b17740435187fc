"""The command `dynid validate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from daq.commands.help_text import CommandApp
from daq.commands.options import JSON, takes
from ident.commands.options import ACCEPT, MAX_ERROR, MAX_JOINT_ERROR, MAX_RMSE
from ident.tasks.options import ValidateOptions

if TYPE_CHECKING:
    from ident.tasks.validation import RecordingValidation, Validation

app = CommandApp("Identify")


@app.command("validate")
@takes(ValidateOptions)
def validate_model(
    *,
    options: ValidateOptions,
    accept: Path = ACCEPT,
    max_error: float = MAX_ERROR,
    max_joint_error: float = MAX_JOINT_ERROR,
    max_rmse: float = MAX_RMSE,
    as_json: bool = JSON,
) -> None:
    """Judge a stored model on other recordings.

    Example: dynid validate model val.h5 --max-error 0.08
    """
    from daq.commands.console import progress_line
    from ident.commands.options import limits_option
    from ident.tasks.validation import validate

    limits = limits_option(accept, max_error, max_joint_error, max_rmse)
    with progress_line(quiet=as_json) as progress:
        progress("prediction")
        validation = validate(**{**vars(options), "accept": limits})
    if as_json:
        _print_object(str(options.identified), validation)
    else:
        _print_tables(validation)
    if validation.acceptance is not None and not validation.acceptance.passed:
        raise typer.Exit(1)


def _print_object(result: str, validation: Validation) -> None:
    from dataclasses import asdict

    from daq.commands.console import print_json

    def fits(one: Validation | RecordingValidation) -> dict[str, Any]:
        return {
            "full": one.full.model_dump(),
            "essential": one.essential.model_dump(),
            "consistent": None if one.consistent is None else one.consistent.model_dump(),
            "delivered": one.delivered.model_dump(mode="json"),
            "verdict": asdict(one.verdict),
        }

    print_json(
        {
            "result": result,
            "joints": list(validation.joints),
            **fits(validation),
            "acceptance": None if validation.acceptance is None else asdict(validation.acceptance),
            "recordings": [
                {"recording": recording.recording, **fits(recording)} for recording in validation.recordings
            ],
        }
    )


def _print_tables(validation: Validation) -> None:
    from ident.commands.print_result import print_fit, print_verdict
    from ident.identify.data_split import labelled
    from ident.result.delivered import DELIVERED_WORDS

    for recording in validation.recordings:
        print(labelled(recording.recording, recording.delivered.overlap))
        words, unit = DELIVERED_WORDS[validation.delivered.parameters], validation.torque_unit
        print_fit(f"{words} model, all samples", validation.joints, unit, recording.delivered.all_samples)
        print_fit(f"{words} model, in motion", validation.joints, unit, recording.delivered.in_motion)
        for name, fit in (("full", recording.full), ("essential", recording.essential)):
            if name != validation.delivered.parameters:
                print_fit(f"{name} model, in motion", validation.joints, unit, fit)
        print_verdict(recording.verdict)
        print()
    if len(validation.recordings) > 1:
        print(f"All recordings together: {validation.verdict.headline}")
    if validation.acceptance is not None:
        print(validation.acceptance)
