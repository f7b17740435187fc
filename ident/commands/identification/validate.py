"""The command `dynid validate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from daq.commands.help_text import CommandApp
from daq.commands.options import JSON, VERBOSE, takes
from ident.commands.options import ACCEPT, MAX_ERROR, MAX_JOINT_ERROR, MAX_RMSE, MODEL_FILE
from ident.tasks.options import ValidateOptions

if TYPE_CHECKING:
    from ident.tasks.validation import Validation

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
    model_file: Path = MODEL_FILE,
    verbose: bool = VERBOSE,
    as_json: bool = JSON,
) -> None:
    """Judge a stored model on other recordings.

    Example: dynid validate model val.h5 --max-error 0.08
    """
    from daq.commands.console import progress_line
    from drivers.core.errors import UsageError
    from ident.commands.identification.gravity import validate_gravity_command
    from ident.commands.identification.servo import refuse_model_file, validate_servo_command
    from ident.commands.options import limits_option
    from ident.result.models.model import result_path
    from ident.result.result_file import GRAVITY, SERVO, kind_of
    from ident.tasks.validation import validate

    path = result_path(str(options.identified))
    kind = kind_of(path)
    if kind != SERVO:
        refuse_model_file(model_file)
    if kind in {SERVO, GRAVITY}:
        if any(limit is not None for limit in (accept, max_error, max_joint_error, max_rmse)):
            raise UsageError(f"a {kind} model has no torque errors to limit", hint="leave --accept and --max-… out")
        if kind == SERVO:
            validate_servo_command(path, options.runs, model_file=model_file, as_json=as_json)
        else:
            validate_gravity_command(path, options.runs, as_json=as_json)
        return
    limits = limits_option(accept, max_error, max_joint_error, max_rmse)
    with progress_line(quiet=as_json) as progress:
        progress("prediction")
        validation = validate(**{**vars(options), "accept": limits})
    if as_json:
        _print_object(str(options.identified), validation)
    else:
        _print_validation(validation, Path(str(options.identified)), verbose=verbose)
    if validation.acceptance is not None and not validation.acceptance.passed:
        raise typer.Exit(1)


def _print_object(result: str, validation: Validation) -> None:
    from dataclasses import fields

    from daq.commands.console import print_json

    print_json({"result": result} | {of.name: getattr(validation, of.name) for of in fields(validation)})


def _print_validation(validation: Validation, model: Path, *, verbose: bool) -> None:
    """The verdict and a row for each recording; with `verbose` the errors of every joint and model."""
    from daq.commands.console import print_table
    from drivers.core.text import in_percent
    from ident.commands.printing.result import print_fit
    from ident.commands.printing.verdict import next_steps, print_everything, print_next, print_purposes
    from ident.identify.data_split import labelled
    from ident.result.delivered import DELIVERED_WORDS

    verdict = validation.verdict
    print(verdict.grades)
    print_purposes(verdict)
    print()
    print_table(
        "",
        ("recording", "error [%]", "in motion [%]", "worst joint", "its error [%]"),
        [
            (
                labelled(judged.recording, judged.delivered.overlap),
                in_percent(judged.delivered.all_samples.relative_error),
                in_percent(judged.delivered.in_motion.relative_error),
                judged.verdict.joints[0].joint if judged.verdict.joints else None,
                None if not judged.verdict.joints else in_percent(judged.verdict.joints[0].error),
            )
            for judged in validation.recordings
        ],
    )
    if validation.acceptance is not None:
        print(validation.acceptance)
    steps = next_steps(verdict, f"dynid predict {model} run.h5, dynid export {model}")
    print_next(steps, verdict, "All figures: --verbose.")
    if not verbose:
        return
    for recording in validation.recordings:
        print(f"\n{labelled(recording.recording, recording.delivered.overlap)}")
        words, unit = DELIVERED_WORDS[validation.delivered.parameters], validation.torque_unit
        print_fit(f"{words} model, all samples", validation.joints, unit, recording.delivered.all_samples)
        print_fit(f"{words} model, in motion", validation.joints, unit, recording.delivered.in_motion)
        for name, fit in (("full", recording.full), ("essential", recording.essential)):
            if name != validation.delivered.parameters:
                print_fit(f"{name} model, in motion", validation.joints, unit, fit)
        print_everything(recording.verdict)
