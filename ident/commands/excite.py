"""The command `dynid excite`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from ident.excite.choices import DesignChoices

if TYPE_CHECKING:
    from daq.robot import Robot
    from ident.excite.design import Design
    from ident.excite.figures import ExcitationFigures
    from ident.excite.search import Found

app = typer.Typer()

DEFAULT_SECONDS = 20.0
"""How long is searched where the user says nothing [s]."""


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
    ramp: float = typer.Option(DesignChoices.ramp, "--ramp", help="Seconds from rest to full pace, and back."),
    seed: int = typer.Option(0, "--seed", help="Of the random starts."),
    seconds: float = typer.Option(None, "--time", help=f"Search for SECONDS; {DEFAULT_SECONDS:g} without --starts."),
    starts: int = typer.Option(None, "--starts", help="Search from this many starts, whatever the machine's speed."),
    earlier: Path = typer.Option(None, "--from", help="Trajectory file to improve."),
    loaded: bool = typer.Option(False, "--loaded", help="Design for the last link, which a payload changes."),
    joints: str = typer.Option(None, "--joints", help="Joints that move, separated by commas; the others rest."),
    prior: Path = typer.Option(None, "--prior", help="result.json that tells parameters and noise."),
    margin: float = typer.Option(DesignChoices.margin, "--margin", help="Share of every limit that is not used."),
    self_collision: bool = typer.Option(True, "--self-collision/--no-self-collision", help="Keep links apart."),
    solver: str = typer.Option("slsqp", "--solver", help="slsqp, trust-constr or ipopt."),
    page: Path = typer.Option(None, "--page", help="Page to write (.html): figures, plots, the arm in motion."),
    force: bool = typer.Option(False, "--force", help="Overwrite the output files."),
    as_json: bool = typer.Option(False, "--json", help="One JSON object on standard output, nothing else there."),
) -> None:
    """Design an excitation trajectory within the arm's limits; Ctrl-C ends the search with the best so far.

    Example: dynid excite ur5e -o traj.yaml --periods 3 --page traj.html
    """
    from daq.console import print_json, progress_line
    from daq.robot import load_robot
    from daq.trajectory_file import load_trajectory
    from drivers.errors import UsageError
    from ident.commands.option_text import joints_option
    from ident.excite.constraints.surroundings import surroundings_warning
    from ident.excite.design import design
    from ident.excite.figures import excitation_figures
    from ident.excite.page.page import write_page
    from ident.excite.prior import find_prior
    from ident.excite.search import SearchChoices

    _check_choices(kind, criterion, solver, seed)
    _check_search(seconds, starts)
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
        text = _trajectory_text(robot_file.robot, found, figures, choices)
        _write(out, text)
        if page is not None:
            progress("page")
            write_page(page, robot_file, found.motion, known, figures, _notes(found, choices))
    if as_json:
        told = _object(robot_file.robot.name, out, page, found, figures, choices)
        print_json(told | {"warnings": [warning] if warning is not None else []})
    else:
        _print(out, page, found, figures, choices)
        if warning is not None:
            print(f"\nwarning: {warning}")


def _check_choices(kind: str, criterion: str, solver: str, seed: int) -> None:
    from typing import get_args

    from drivers.errors import UsageError
    from ident.excite.choices import CriterionName, Kind
    from ident.excite.solve import Solver

    for option, value, allowed in (
        ("--kind", kind, get_args(Kind)),
        ("--criterion", criterion, get_args(CriterionName)),
        ("--solver", solver, get_args(Solver)),
    ):
        if value not in allowed:
            raise UsageError(f"{option} '{value}' does not exist", hint=f"one of: {', '.join(allowed)}")
    if seed < 0:
        raise UsageError(f"--seed {seed} is below 0")


def _check_search(seconds: float | None, starts: int | None) -> None:
    from math import isfinite

    from drivers.errors import UsageError

    if seconds is not None and starts is not None:
        raise UsageError(
            "--time and --starts exclude each other", hint="--starts does not depend on the machine's speed"
        )
    if seconds is not None and not (isfinite(seconds) and seconds > 0):
        raise UsageError(f"--time {seconds:g} is not a positive number of seconds")
    if starts is not None and starts < 1:
        raise UsageError(f"--starts {starts} is less than 1")


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


def _state(found: Found) -> str:
    best = f"condition number {found.best.condition:.4g}" if found.best is not None else "nothing within the limits yet"
    return f"{found.seconds:.0f} s, {found.finished} starts finished, best so far: {best}"


def _summary(found: Design, figures: ExcitationFigures, choices: DesignChoices) -> str:
    """The figures in one line."""
    forecast = figures.forecast
    use, limit = max([(figures.worst_use, figures.worst_limit), *zip(found.use.tolist(), found.limits, strict=True)])
    return (
        f"{choices.kind} of {figures.duration:.4g} s, {choices.criterion} {found.cost:.4g} along one repetition; "
        f"as played: condition {forecast.condition:.4g}, with scaled columns {forecast.scaled_condition:.4g}, "
        f"largest use of a limit {100 * use:.3g} % ({limit})"
    )


def _trajectory_text(robot: Robot, found: Design, figures: ExcitationFigures, choices: DesignChoices) -> str:
    """The file's text, read back and checked as `dynid record` will do it.

    Raises:
        IdentificationError: it would be refused.
    """
    from daq.trajectory_file import dump_trajectory, parse_trajectory
    from drivers.errors import IdentificationError, UsageError

    comment = f"designed by dynid excite: {_summary(found, figures, choices)}"
    text = dump_trajectory(found.family.trajectory(found.variables, robot.name, comment))
    try:
        parse_trajectory(text, robot, where="the designed trajectory", folder=None)
    except UsageError as error:
        raise IdentificationError(error.message, where=error.where, hint="give a larger --margin") from error
    return text


def _write(path: Path, text: str) -> None:
    from drivers.errors import UsageError
    from ident.result.schema import replace_file

    try:
        replace_file(path, text)
    except OSError as error:
        raise UsageError(f"cannot be written: {error.strerror}", where=str(path)) from error


def _search_words(found: Design) -> str:
    state = found.found
    ended = ", ended by Ctrl-C" if state.interrupted else ""
    return f"{state.finished} starts finished in {state.seconds:.1f} s{ended}"


def _notes(found: Design, choices: DesignChoices) -> list[tuple[str, str]]:
    """What the page tells of the design."""
    return [
        ("Kind", choices.kind),
        ("Criterion", f"{choices.criterion}: {found.cost:.4g} along one repetition at full pace"),
        ("Designed for", "the last link, which a payload changes" if choices.loaded else "all base parameters"),
        ("Joints that move", ", ".join(choices.moving) if choices.moving else "all"),
        ("Margin", f"{100 * choices.margin:g} % of every limit"),
        ("Self-collision", "looked for" if choices.self_collision else "not looked for"),
        ("Search", _search_words(found)),
    ]


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
            "finished_starts": found.found.finished,
            "seconds": found.found.seconds,
            "interrupted": found.found.interrupted,
        },
        "limits": {name: float(use) for name, use in zip(found.limits, found.use, strict=True)},
        "figures": asdict(figures),
    }


def _print(out: Path, page: Path | None, found: Design, figures: ExcitationFigures, choices: DesignChoices) -> None:
    from daq.console import print_table
    from ident.regression.pruning import SIGNIFICANT_RSD

    if found.found.interrupted:
        print("Ctrl-C ended the search; this is the best motion so far that keeps every limit.")
    print_table(
        "Use of the limits [%]",
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
    print(f"\n{_summary(found, figures, choices)}")
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
    print(_search_words(found))
    print(f"\n{out}")
    if page is not None:
        print(page)
