"""The command `dynid identify`."""

from __future__ import annotations

from pathlib import Path

import typer

from daq.commands.help_text import CommandApp
from daq.commands.options import FORCE, JSON, VERBOSE, takes
from ident.commands.options import ACCEPT, MAX_ERROR, MAX_JOINT_ERROR, MAX_RMSE, METHOD, MODEL_FILE
from ident.tasks.options import IdentifyOptions

app = CommandApp("Identify")


@app.command("identify")
@takes(IdentifyOptions, method=METHOD, rest_tolerance={"show_default": False})
def identify_recordings(
    *,
    out: Path = typer.Option(None, "-o", "--out", help="Folder for result.json and report.html."),
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
    from daq.commands.console import progress_line
    from daq.output_files import REPORT_FILE, RESULT_FILE, check_output_folder
    from daq.robot.loader import load_robot
    from ident.commands.identification.gravity import identify_gravity_command, print_gravity
    from ident.commands.identification.servo import identify_servo_command, is_servo, print_servo, refuse_model_file
    from ident.commands.options import limits_option
    from ident.commands.printing.result import print_result
    from ident.result.friction_experiment import friction_path
    from ident.tasks.arguments import paths_of
    from ident.tasks.identification import identify

    recordings, robot = paths_of(options.runs), options.robot
    folder = out if out is not None else Path(f"{recordings[0].stem}-model")
    experiment = None if options.friction_from is None else friction_path(options.friction_from)
    inputs = [
        *recordings,
        *paths_of(options.validation),
        accept,
        experiment,
        model_file,
        *(load_robot(robot).files if robot else ()),
    ]
    check_output_folder(folder, (RESULT_FILE, REPORT_FILE), inputs, overwrite=force)
    if not is_servo(options.method):
        refuse_model_file(model_file)
    if history is not None:
        from ident.history.database import check_history

        check_history(history)
    limits = limits_option(accept, max_error, max_joint_error, max_rmse)
    with progress_line(quiet=as_json) as progress:
        limited = any(limit is not None for limit in (accept, max_error, max_joint_error, max_rmse))
        if gravity:
            identified = identify_gravity_command(options, folder, progress, limited=limited, overwrite=force)
            _add_to_history(folder, history)
            print_gravity(identified, folder, verbose=verbose, as_json=as_json)
            return
        if is_servo(options.method):
            servo = identify_servo_command(
                options, folder, progress, model_file=model_file, limited=limited, overwrite=force
            )
            _add_to_history(folder, history)
            print_servo(servo, folder, verbose=verbose, as_json=as_json)
            return
        result = identify(**{**vars(options), "accept": limits, "progress": progress})
        progress("report")
        result.save(folder, overwrite=force)
        _add_to_history(folder, history)
    if as_json:
        print((folder / RESULT_FILE).read_text(encoding="utf-8"), end="")
    else:
        print_result(result.result, folder / REPORT_FILE, verbose=verbose)
    if result.acceptance is not None and not result.acceptance.passed:
        raise typer.Exit(1)


def _add_to_history(folder: Path, database: Path | None) -> None:
    """Add the result in a folder; nothing where no history is named."""
    if database is not None:
        from ident.tasks.history import History

        History(database).add(folder)
