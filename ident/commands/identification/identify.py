"""The command `dynid identify`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from daq.commands.help_text import CommandApp
from daq.commands.options import FORCE, JSON, VERBOSE, folder_option, takes
from ident.commands.options import ACCEPT, MAX_ERROR, MAX_JOINT_ERROR, MAX_RMSE, METHOD, MODEL_FILE
from ident.tasks.options import IdentifyOptions

if TYPE_CHECKING:
    from drivers.core.reading_process import Progress
    from ident.tasks.identification import IdentificationResult

app = CommandApp("Identify")


@app.command("identify")
@takes(IdentifyOptions, method=METHOD, rest_tolerance={"show_default": False})
def identify_recordings(
    *,
    out: Path = folder_option("result.json"),
    options: IdentifyOptions,
    accept: Path = ACCEPT,
    max_error: float = MAX_ERROR,
    max_joint_error: float = MAX_JOINT_ERROR,
    max_rmse: float = MAX_RMSE,
    gravity: bool = typer.Option(
        False, "--gravity", help="Identify gravity alone, from a recording of dynid excite --for gravity."
    ),
    model_file: Path = MODEL_FILE,
    history: Path = typer.Option(None, "--history", help="Add the result to this history (dynid history)."),
    verbose: bool = VERBOSE,
    force: bool = FORCE,
    as_json: bool = JSON,
) -> None:
    """Identify the model, validate it on held-out data, report.

    Example: dynid identify run.h5 --validate val.h5 -o model
    """
    from daq.output_files import REPORT_FILE, RESULT_FILE
    from ident.commands.identification.gravity import GRAVITY_USE, identify_gravity_command
    from ident.commands.identification.servo import SERVO_USE, identify_servo_command, is_servo, refuse_model_file
    from ident.commands.options import limits_option
    from ident.commands.printing.result import print_identified, print_result
    from ident.commands.saving import check_result_folder, save_result
    from ident.result.friction_experiment import friction_path
    from ident.tasks.arguments import GradedResult, paths_of
    from ident.tasks.identification import identify

    folder = out if out is not None else Path(f"{paths_of(options.runs)[0].stem}-model")
    experiment = None if options.friction_from is None else friction_path(options.friction_from)
    inputs = [options.runs, options.validation, accept, experiment, model_file]
    check_result_folder(folder, RESULT_FILE, inputs, options.robot, overwrite=force)
    if not is_servo(options.method):
        refuse_model_file(model_file)
    if history is not None:
        from ident.history.database import check_history

        check_history(history)
    limits = limits_option(accept, max_error, max_joint_error, max_rmse)
    limited = any(limit is not None for limit in (accept, max_error, max_joint_error, max_rmse))

    def run(progress: Progress) -> IdentificationResult | GradedResult:
        if gravity:
            return identify_gravity_command(options, progress, limited=limited)
        if is_servo(options.method):
            return identify_servo_command(options, progress, model_file=model_file, limited=limited)
        return identify(**{**vars(options), "accept": limits, "progress": progress})

    result = save_result(run, folder, overwrite=force, as_json=as_json)
    if history is not None:
        from ident.tasks.history import History

        History(history).add(folder)
    if as_json:
        print((folder / RESULT_FILE).read_text(encoding="utf-8"), end="")
    elif isinstance(result, GradedResult):
        print_identified(result, folder, (GRAVITY_USE if gravity else SERVO_USE).format(folder=folder), verbose=verbose)
    else:
        print_result(result.result, folder / REPORT_FILE, verbose=verbose)
    if not isinstance(result, GradedResult) and result.acceptance is not None and not result.acceptance.passed:
        raise typer.Exit(1)
