"""The command `dynid excite`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from ident.commands.options import FORCE, JSON, ROBOT
from ident.excite.choices import DEFAULT_SECONDS, DesignChoices

if TYPE_CHECKING:
    from ident.tasks.excitation import ExcitationTrajectory

app = typer.Typer()


@app.command("excite")
def excite(
    robot: str = ROBOT,
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
    prior: Path = typer.Option(None, "--prior", help="Model folder or result.json with prior parameters and noise."),
    margin: float = typer.Option(DesignChoices.margin, "--margin", help="Share of every limit kept free."),
    self_collision: bool = typer.Option(True, "--self-collision/--no-self-collision", help="Keep links apart."),
    solver: str = typer.Option("slsqp", "--solver", help="slsqp, trust-constr, ipopt or sfla."),
    page: Path = typer.Option(None, "--page", help="Page to write (.html): figures, plots, the arm in motion."),
    force: bool = FORCE,
    as_json: bool = JSON,
) -> None:
    """Design an excitation trajectory within the arm's limits; Ctrl-C ends the search with the best so far.

    Example: dynid excite ur5e -o traj.yaml --periods 3 --page traj.html
    """
    from daq.commands.console import print_json, progress_line
    from daq.output_files import check_outputs, written_together
    from daq.robot.loader import load_robot
    from ident.commands.options import names_option
    from ident.result.model import result_path
    from ident.tasks.excitation import design_excitation, load_trajectory, search_state

    prior_file = None if prior is None else result_path(prior)
    check_outputs([out, page], [*load_robot(robot).files, earlier, prior_file], overwrite=force)
    with progress_line(quiet=as_json) as progress:
        progress("search")
        trajectory = design_excitation(
            robot,
            kind=kind,  # type: ignore[arg-type]  # the task checks it
            criterion=criterion,  # type: ignore[arg-type]
            harmonics=harmonics,
            points=points,
            period=period,
            periods=periods,
            ramp=ramp,
            seed=seed,
            time=seconds,
            starts=starts,
            loaded=loaded,
            joints=names_option(joints, "--joints"),
            prior=prior_file,
            margin=margin,
            self_collision=self_collision,
            solver=solver,  # type: ignore[arg-type]
            earlier=None if earlier is None else load_trajectory(earlier, robot),
            progress=lambda result: progress(search_state(result, criterion)),
        )
        with written_together():
            trajectory.save(out)
            if page is not None:
                progress("page")
                trajectory.page(page)
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
    from ident.regression.pruning import SIGNIFICANT_RSD
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
