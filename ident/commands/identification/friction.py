"""The command `dynid friction`."""

from __future__ import annotations

from pathlib import Path

import typer

from daq.commands.help_text import CommandApp
from daq.commands.options import FORCE, JSON, takes
from ident.tasks.options import FrictionOptions

app = CommandApp("Identify")


@app.command("friction")
@takes(FrictionOptions)
def find_friction(
    *,
    options: FrictionOptions,
    out: Path = typer.Option(None, "-o", "--out", help="Folder for friction.json and report.html."),
    force: bool = FORCE,
    as_json: bool = JSON,
) -> None:
    """Identify joint friction over speed, temperature and load.

    Example: dynid friction cold.h5 warm.h5 warmer.h5 -o friction
    """
    from daq.commands.console import progress_line
    from daq.output_files import REPORT_FILE, check_output_folder
    from daq.robot.loader import load_robot
    from ident.commands.printing.result import print_tables
    from ident.result.friction_experiment import FRICTION_FILE
    from ident.tasks.arguments import paths_of
    from ident.tasks.experiments import friction
    from ident.views.friction_tables import COEFFICIENTS

    recordings, robot = paths_of(options.runs), options.robot
    folder = out if out is not None else Path(f"{recordings[0].stem}-friction")
    inputs = [*recordings, *(load_robot(robot).files if robot else ())]
    check_output_folder(folder, (FRICTION_FILE, REPORT_FILE), inputs, overwrite=force)
    with progress_line(quiet=as_json) as progress:
        identified = friction(**{**vars(options), "progress": progress})
        progress("report")
        identified.save(folder, overwrite=force)
    if as_json:
        print(identified.to_json())
        return
    result = identified.result
    print(f"delay: {result.delay_note}")
    print_tables([identified.table.pick(*COEFFICIENTS)])
    for warning in result.warnings:
        print(f"warning: {warning}")
    print(f"\n{folder / FRICTION_FILE}\n{folder / REPORT_FILE}")
