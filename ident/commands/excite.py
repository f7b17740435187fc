"""The command `dynid excite`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from daq.commands.help_text import CommandApp
from daq.commands.options import FORCE, JSON, takes
from ident.tasks.options import ExciteOptions

if TYPE_CHECKING:
    from ident.excite.search.search import SearchResult
    from ident.tasks.excitation import ExcitationTrajectory

app = CommandApp("Record")


@app.command("excite")
@takes(ExciteOptions)
def excite(
    *,
    out: Path = typer.Option(..., "-o", "--out", help="Trajectory file to write (.yaml)."),
    options: ExciteOptions,
    page: Path = typer.Option(None, "--page", help="Page to write (.html): figures, plots, the arm in motion."),
    force: bool = FORCE,
    as_json: bool = JSON,
) -> None:
    """Design an excitation trajectory within the arm's limits.

    Ctrl-C ends the search with the best motion so far.

    Example: dynid excite ur5e -o traj.yaml --page traj.html
    """
    from daq.commands.console import print_json, progress_line
    from daq.output_files import check_outputs, written_together
    from daq.robot.loader import load_robot
    from ident.result.model import result_path
    from ident.tasks.arguments import paths_of
    from ident.tasks.excitation import design_excitation, search_state

    prior_file = None if options.prior is None else result_path(options.prior)
    inputs = [*load_robot(options.robot).files, *paths_of(options.earlier), prior_file]
    check_outputs([out, page], inputs, overwrite=force)

    def tell(result: SearchResult) -> None:
        progress(search_state(result, options.criterion))

    with progress_line(quiet=as_json) as progress:
        progress("search")
        trajectory = design_excitation(**{**vars(options), "progress": tell})
        with written_together():
            trajectory.save(out, overwrite=force)
            if page is not None:
                progress("page")
                trajectory.page(page, overwrite=force)
    if as_json:
        print_json(_object(trajectory, out, page))
        return
    _print(trajectory, out, page)
    for warning in trajectory.warnings:
        print(f"\nwarning: {warning}")


def _object(trajectory: ExcitationTrajectory, out: Path, page: Path | None) -> dict[str, Any]:
    from dataclasses import asdict

    design = trajectory.design
    assert design is not None
    return {
        "file": str(out),
        "page": None if page is None else str(page),
        "robot": trajectory.robot_file.robot.name,
        "choices": asdict(design.choices),
        "cost": design.cost,
        "search": {
            "finished_starts": design.search.finished,
            "seconds": design.search.seconds,
            "interrupted": design.search.interrupted,
        },
        "limits": dict(zip(design.limits, design.use.tolist(), strict=True)),
        "figures": asdict(trajectory.figures),
        "warnings": list(trajectory.warnings),
    }


def _print(trajectory: ExcitationTrajectory, out: Path, page: Path | None) -> None:
    from daq.commands.console import print_table
    from ident.regression.options import SIGNIFICANT_RSD
    from ident.tasks.excitation import search_words

    design, forecast = trajectory.design, trajectory.figures.forecast
    assert design is not None
    if design.search.interrupted:
        print("Ctrl-C ended the search; this is the best feasible motion so far.")
    columns = trajectory.limits.columns
    rows = zip(*(column.cells for column in columns), strict=True)
    print_table("Limit utilisation [%]", [column.name for column in columns], rows)
    print(f"\n{trajectory.summary}")
    known = [p.rsd_percent for p in forecast.parameters if p.rsd_percent is not None]
    if known:
        significant = sum(value < SIGNIFICANT_RSD for value in known)
        print(
            f"predicted RSD below {SIGNIFICANT_RSD:g} % for {significant} of {len(known)} base parameters "
            f"(white noise; {trajectory.figures.prior})"
        )
    if forecast.unexcited:
        print(f"not excited: {', '.join(forecast.unexcited)}")
    print(search_words(design))
    print(f"\n{out}")
    if page is not None:
        print(page)
