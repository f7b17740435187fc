"""The command `dynid excite`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from ident.excite.choices import DEFAULT_SECONDS, DesignChoices

if TYPE_CHECKING:
    from ident.excite.design import Design
    from ident.excite.figures import ExcitationFigures
    from ident.excite.search import SearchResult

app = typer.Typer()


@app.command("excite")
def excite(
    robot: str = typer.Argument(help="Built-in robot or robot file."),
    out: Path = typer.Option(..., "-o", "--out", help="Trajectory file to write (.yaml)."),
    kind: str = typer.Option(DesignChoices.kind, "--kind", help="fourier, fourier-quintic, sines or points."),
    criterion: str = typer.Option(
        DesignChoices.criterion,
        "--criterion",
        help="d-optimal, e-optimal, deviations, condition, plain-condition, moments, hadamard or motion-size.",
    ),
    harmonics: int = typer.Option(
        DesignChoices.harmonics, "--harmonics", help="Harmonics of the series, or number of sines."
    ),
    points: int = typer.Option(DesignChoices.points, "--points", help="Points of a point-to-point motion."),
    period: float = typer.Option(DesignChoices.period, "--period", help="Seconds of one repetition."),
    periods: int = typer.Option(DesignChoices.periods, "--periods", help="Repetitions."),
    ramp: float = typer.Option(DesignChoices.ramp, "--ramp", help="Seconds from rest to full speed, and back."),
    seed: int = typer.Option(0, "--seed", help="Of the random starts."),
    seconds: float = typer.Option(None, "--time", help=f"Search for SECONDS; {DEFAULT_SECONDS:g} without --starts."),
    starts: int = typer.Option(None, "--starts", help="Search from this many starts, whatever the machine's speed."),
    earlier: Path = typer.Option(None, "--from", help="Trajectory file to improve."),
    loaded: bool = typer.Option(
        False, "--loaded", help="Design for identifying a payload: the parameters of the last link."
    ),
    joints: str = typer.Option(None, "--joints", help="Joints that move, separated by commas; the others rest."),
    prior: Path = typer.Option(None, "--prior", help="result.json with prior parameters and noise."),
    margin: float = typer.Option(DesignChoices.margin, "--margin", help="Share of every limit kept free."),
    self_collision: bool = typer.Option(True, "--self-collision/--no-self-collision", help="Keep links apart."),
    solver: str = typer.Option("slsqp", "--solver", help="slsqp, trust-constr or ipopt."),
    page: Path = typer.Option(None, "--page", help="Page to write (.html): figures, plots, the arm in motion."),
    force: bool = typer.Option(False, "--force", help="Overwrite the output files."),
    as_json: bool = typer.Option(False, "--json", help="One JSON object on standard output, nothing else there."),
) -> None:
    """Design an excitation trajectory within the arm's limits; Ctrl-C ends the search with the best so far.

    Example: dynid excite ur5e -o traj.yaml --periods 3 --page traj.html
    """
    from daq.commands.console import print_json, progress_line
    from daq.motion.trajectory_file import load_trajectory
    from daq.robot.loader import load_robot
    from drivers.errors import UsageError
    from ident.commands.option_text import joints_option
    from ident.excite.constraints.surroundings import surroundings_warning
    from ident.excite.design import design
    from ident.excite.figures import excitation_figures
    from ident.excite.page.page import write_page
    from ident.excite.prior import find_prior
    from ident.excite.search import SearchChoices
    from ident.tasks.excitation import check_design, check_search, design_notes, trajectory_text

    check_design(kind, criterion, solver, seed)
    check_search(seconds, starts)
    for path in (out, page):
        _check_file(path, force)
    if page is not None and page.resolve() == out.resolve():
        raise UsageError("--out and --page name the same file", where=str(page))
    robot_file = load_robot(robot)
    known = find_prior(robot_file, prior)
    choices = DesignChoices(
        kind=kind,  # type: ignore[arg-type]  # checked above
        criterion=criterion,  # type: ignore[arg-type]  # checked above
        harmonics=harmonics,
        points=points,
        period=period,
        periods=periods,
        ramp=ramp,
        moving=joints_option(joints, "--joints"),
        loaded=loaded,
        margin=margin,
        self_collision=self_collision,
    )
    search_choices = SearchChoices(
        seed=seed,
        starts=starts,
        seconds=DEFAULT_SECONDS if seconds is None and starts is None else seconds,
        solver=solver,  # type: ignore[arg-type]  # checked above
    )
    start = load_trajectory(earlier, robot_file.robot).motion if earlier is not None else None
    with progress_line(quiet=as_json) as progress:
        progress("search")
        found = design(robot_file, known, choices, search_choices, start, lambda state: progress(_state(state)))
        progress("figures")
        figures = excitation_figures(robot_file, found.motion, known)
        warning = surroundings_warning(robot_file, found.motion)
        text = trajectory_text(robot_file.robot, found, figures, choices)
        _write(out, text)
        if page is not None:
            progress("page")
            write_page(page, robot_file, found.motion, known, figures, design_notes(found, choices))
    if as_json:
        told = _object(robot_file.robot.name, out, page, found, figures, choices)
        print_json(told | {"warnings": [warning] if warning is not None else []})
    else:
        _print(out, page, found, figures, choices)
        if warning is not None:
            print(f"\nwarning: {warning}")


def _check_file(path: Path | None, force: bool) -> None:
    """Refuse an output file that cannot be written, before the search is paid for."""
    from drivers.errors import UsageError

    if path is None:
        return
    if path.is_dir():
        raise UsageError("is a folder; a file is needed", where=str(path))
    if path.exists() and not force:
        raise UsageError("exists already", where=str(path), hint="overwrite it with --force")
    if not path.parent.is_dir():
        raise UsageError(f"there is no folder {path.parent}", where=str(path))


def _state(found: SearchResult) -> str:
    best = f"condition number {found.best.condition:.4g}" if found.best is not None else "no feasible motion yet"
    return f"{found.seconds:.0f} s, {found.finished} starts finished, best so far: {best}"


def _write(path: Path, text: str) -> None:
    from drivers.errors import UsageError
    from ident.result.schema import replace_file

    try:
        replace_file(path, text)
    except OSError as error:
        raise UsageError(f"cannot be written: {error.strerror}", where=str(path)) from error


def _object(
    robot: str, out: Path, page: Path | None, found: Design, figures: ExcitationFigures, choices: DesignChoices
) -> dict[str, Any]:
    from dataclasses import asdict

    return {
        "file": str(out),
        "page": None if page is None else str(page),
        "robot": robot,
        "choices": asdict(choices),
        "cost": found.cost,
        "search": {
            "finished_starts": found.search.finished,
            "seconds": found.search.seconds,
            "interrupted": found.search.interrupted,
        },
        "limits": {name: float(use) for name, use in zip(found.limits, found.use, strict=True)},
        "figures": asdict(figures),
    }


def _print(out: Path, page: Path | None, found: Design, figures: ExcitationFigures, choices: DesignChoices) -> None:
    from daq.commands.console import print_table
    from ident.regression.pruning import SIGNIFICANT_RSD
    from ident.tasks.excitation import design_summary, search_words

    if found.search.interrupted:
        print("Ctrl-C ended the search; this is the best feasible motion so far.")
    print_table(
        "Limit utilisation [%]",
        ("joint", "position", "velocity", "acceleration", "torque"),
        [
            (
                joint.joint,
                100.0 * joint.position_use,
                100.0 * joint.velocity_use,
                100.0 * joint.acceleration_use,
                None if joint.torque_use is None else 100.0 * joint.torque_use,
            )
            for joint in figures.joints
        ],
    )
    print(f"\n{design_summary(found, figures, choices)}")
    forecast = figures.forecast
    known = [p.rsd_percent for p in forecast.parameters if p.rsd_percent is not None]
    if known:
        significant = sum(value < SIGNIFICANT_RSD for value in known)
        print(
            f"predicted RSD below {SIGNIFICANT_RSD:g} % for {significant} of {len(known)} base parameters "
            f"(white noise; {figures.prior})"
        )
    if forecast.unexcited:
        print(f"not excited: {', '.join(forecast.unexcited)}")
    print(search_words(found))
    print(f"\n{out}")
    if page is not None:
        print(page)
