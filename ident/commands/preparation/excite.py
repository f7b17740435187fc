"""The command `dynid excite`."""

from __future__ import annotations

from pathlib import Path

import typer

from daq.commands.help_text import CommandApp
from daq.commands.options import FORCE, JSON, takes
from ident.commands.preparation.excite_purposes import ExciteCommandOptions

app = CommandApp("Record")


@app.command("excite")
@takes(ExciteCommandOptions)
def excite(
    *,
    out: Path = typer.Option(..., "-o", "--out", help="Trajectory file to write (.yaml)."),
    options: ExciteCommandOptions,
    csv: Path = typer.Option(None, "--csv", help="Table of positions to write (.csv), for a player of your own."),
    page: Path = typer.Option(None, "--page", help="Page to write (.html): figures, plots, the arm in motion."),
    force: bool = FORCE,
    as_json: bool = JSON,
) -> None:
    """Design an excitation trajectory within the arm's limits.

    Ctrl-C ends the search with the best motion so far.

    Example: dynid excite ur5e -o traj.yaml --page traj.html
    """
    from daq.commands.console import print_json, print_table, progress_line
    from daq.motion.trajectory_file import with_files
    from daq.output_files import check_outputs, written_together
    from daq.robot.loader import load_robot
    from ident.commands.preparation.excite_purposes import purpose_of
    from ident.result.models.model import result_path
    from ident.tasks.arguments import paths_of

    purpose = purpose_of(options)
    prior_file = None if options.prior is None else result_path(options.prior)
    inputs = [*load_robot(options.robot).files, *paths_of(options.earlier), prior_file]
    check_outputs([out, csv, page], inputs, overwrite=force)
    with progress_line(quiet=as_json) as progress:
        designed = purpose.design(options, progress)
        trajectory = designed.trajectory
        with written_together() as texts:
            if trajectory is not None:
                trajectory.save(out, overwrite=force)
            if trajectory is not None and csv is not None:
                trajectory.save_csv(csv, overwrite=force)
            if trajectory is not None and page is not None:
                progress("page")
                trajectory.page(page, overwrite=force)
                if page.parent == out.parent:
                    texts[out] = with_files(texts[out], {page.name: texts[page]})
    if as_json:
        print_json(
            {
                "file": None if trajectory is None else str(out),
                "csv": None if csv is None else str(csv),
                "page": None if page is None else str(page),
                "robot": load_robot(options.robot).robot.name,
                "for": options.purpose,
                **designed.object,
                "warnings": [] if trajectory is None else list(trajectory.warnings),
            }
        )
        return
    if trajectory is None:
        print(*designed.lines, sep="\n")
        return
    print_table(designed.title, designed.headings, designed.rows)
    print("", *designed.lines, "", out, sep="\n")
    if csv is not None:
        print(csv)
    if page is not None:
        print(page)
    for warning in trajectory.warnings:
        print(f"\nwarning: {warning}")
