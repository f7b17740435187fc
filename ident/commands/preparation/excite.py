"""The command `dynid excite`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from daq.commands.help_text import CommandApp
from daq.commands.options import FORCE, JSON, csv_option, out_option, page_option, takes
from drivers.core.options import Options, option, same_named
from ident.commands.options import refuse_options_but
from ident.excite.choices import PoseCount, ServoMotionLength
from ident.tasks.options import ExciteOptions, GravityMotionOptions, ServoMotionOptions

if TYPE_CHECKING:
    from ident.tasks.excitation import ExcitationTrajectory


FULL, GRAVITY, SERVO = "full", "gravity", "servo"


@dataclass(frozen=True)
class DesignedMotion:
    """A motion of any purpose, with what the command says of it."""

    trajectory: ExcitationTrajectory | None  # to be written; None where no further motion is needed
    title: str  # of the table
    # headings, rows: of the table
    headings: Sequence[str]
    rows: Sequence[Sequence[Any]]
    lines: Sequence[str]  # below the table
    object: Mapping[str, Any]  # what `--json` has beside file, page, robot and warnings


@dataclass(frozen=True)
class Purpose:
    """What a motion is for."""

    summary: str  # for the help
    options: type[Options]  # whose fields it heeds; another option that is given is refused
    # makes the motion; the second argument shows progress
    design: Callable[[ExciteCommandOptions, Callable[[str], None]], DesignedMotion]


def design_full(options: ExciteCommandOptions, progress: Callable[[str], None]) -> DesignedMotion:
    """Design an excitation of all parameters."""
    from drivers.core.text import percent_text
    from ident.regression.options import SIGNIFICANT_RSD
    from ident.tasks.excitation import design_excitation, search_state, search_words

    progress("search")
    given = vars(same_named(options, ExciteOptions))
    trajectory = design_excitation(**{**given, "progress": lambda result: progress(search_state(result))})
    design, forecast = trajectory.design, trajectory.figures.forecast
    assert design is not None
    columns = trajectory.limits.columns
    lines = ["Ctrl-C ended the search; this is the best feasible motion so far."] if design.search.interrupted else []
    lines.append(trajectory.summary)
    rsds = [p.rsd_percent for p in forecast.parameters if p.rsd_percent is not None]
    if rsds:
        significant = sum(value < SIGNIFICANT_RSD for value in rsds)
        lines.append(
            f"predicted RSD below {percent_text(SIGNIFICANT_RSD / 100.0)} for {significant} of {len(rsds)} base "
            f"parameters (white noise; {trajectory.figures.prior})"
        )
    if forecast.unexcited:
        lines.append(f"not excited: {', '.join(forecast.unexcited)}")
    lines.append(search_words(design))
    return DesignedMotion(
        trajectory,
        "Limit utilisation [%]",
        [column.name for column in columns],
        list(zip(*(column.cells for column in columns), strict=True)),
        lines,
        {
            "choices": design.choices,
            "cost": design.cost,
            "search": {
                "finished_starts": design.search.finished,
                "seconds": design.search.seconds,
                "interrupted": design.search.interrupted,
            },
            "limits": dict(zip(design.limits, design.use, strict=True)),
            "figures": trajectory.figures,
        },
    )


def design_gravity(options: ExciteCommandOptions, progress: Callable[[str], None]) -> DesignedMotion:
    """Design poses that are passed slowly from both sides."""
    from ident.tasks.excitation import design_gravity_motion

    progress("poses")
    trajectory, designed = design_gravity_motion(**vars(same_named(options, GravityMotionOptions)))
    robot = trajectory.robot_file.robot
    rows = [
        [joint.name, float(low), float(high), float(2.0 * half), float(sigma), joint.unit("N·m")]
        for joint, low, high, half, sigma in zip(
            robot.joints,
            designed.poses.min(axis=0),
            designed.poses.max(axis=0),
            designed.half_stroke,
            designed.sigma,
            strict=True,
        )
    ]
    lines = [
        f"{trajectory.duration:.0f} s: {len(designed.poses)} poses, each passed upwards and downwards in "
        f"{designed.pass_time:.2g} s, the first one again at the end",
        f"σ is that of the gravity torque to expect (white noise; {trajectory.prior.source})",
    ]
    if designed.silent:
        lines.append(f"gravity does not act on {', '.join(designed.silent)}: only friction and offset")
    if designed.undetermined:
        lines.append(f"not determined: {', '.join(designed.undetermined)}")
    if designed.dropped:
        lines.append(f"{designed.dropped} more poses were chosen, but no free path leads to them")
    return DesignedMotion(
        trajectory,
        "Poses",
        ("joint", "from", "to", "pass", "expected σ", "unit"),
        rows,
        lines,
        {
            "duration": trajectory.duration,
            "poses": designed.poses,
            "pass_length": 2.0 * designed.half_stroke,
            "pass_time": designed.pass_time,
            "expected_sigma": designed.sigma,
            "silent": designed.silent,
            "undetermined": designed.undetermined,
        },
    )


def design_servo(options: ExciteCommandOptions, progress: Callable[[str], None]) -> DesignedMotion:
    """Design ramps, steps and chirps, for all parameters or for those that are still wide."""
    from ident.tasks.excitation import design_servo_motion

    progress("pieces of motion")
    trajectory, designed = design_servo_motion(**vars(same_named(options, ServoMotionOptions)))
    rows: list[list[Any]] = [
        [forecast.joint, forecast.parameter.replace("_", " "), forecast.now, forecast.then, forecast.wanted]
        for forecast in designed.forecast
    ]
    lines = []
    if trajectory is not None:
        lines.append(f"{trajectory.duration:.0f} s: {designed.counts}, of all joints at once")
    if designed.enough:
        after = "" if trajectory is None else " is expected after this motion: identify from all recordings together"
        lines.append(f"enough: every interval within {options.wanted:g} %{after}")
    elif designed.forecast:
        loose = [
            f"{forecast.joint} {forecast.parameter.replace('_', ' ')}"
            for forecast in designed.forecast
            if forecast.then > forecast.wanted
        ]
        lines.append(f"not enough for {', '.join(loose)}; identify from all recordings, and continue with --after")
    else:
        lines.append(
            "then: dynid identify RUN.h5 --method servo -o model; dynid excite ROBOT --for servo --after model"
        )
    return DesignedMotion(
        trajectory,
        "95 % intervals, half-widths [%]" if rows else "Pieces",
        ("joint", "parameter", "now", "expected", "wanted") if rows else ("kind", "amplitude", "pose"),
        rows or [[segment.kind, segment.amplitude, segment.pose] for segment in designed.segments],
        lines,
        {
            "duration": 0.0 if trajectory is None else trajectory.duration,
            "enough": designed.enough,
            "forecast": designed.forecast,
            "pieces": [
                {"kind": segment.kind, "amplitude": segment.amplitude, "pose": segment.pose}
                for segment in designed.segments
            ],
        },
    )


PURPOSES = {
    FULL: Purpose("all parameters", ExciteOptions, design_full),
    GRAVITY: Purpose("gravity compensation", GravityMotionOptions, design_gravity),
    SERVO: Purpose("arms without torque sensors", ServoMotionOptions, design_servo),
}
"""Purposes by their name."""


@dataclass(frozen=True)
class ExciteCommandOptions(PoseCount, ServoMotionLength, ExciteOptions):
    """Options of `dynid excite`: those of every purpose."""

    purpose: str = option(
        FULL,
        f"Purpose of the motion: {', '.join(f'{name} ({text.summary})' for name, text in PURPOSES.items())}.",
        flag="--for",
        one_of=tuple(PURPOSES),
        panel="",
    )


def purpose_of(options: ExciteCommandOptions) -> Purpose:
    """The purpose that the options name.

    Raises:
        UsageError: an option that it does not heed is given.
    """
    purpose = PURPOSES[options.purpose]
    heeded = {of.name for of in fields(cast("Any", purpose.options))} | {"purpose"}
    refuse_options_but(heeded, options, f"--for {options.purpose}")
    return purpose


app = CommandApp("Record")


@app.command("excite")
@takes(ExciteCommandOptions)
def excite(
    *,
    out: Path = out_option("Trajectory file to write (.yaml).", ...),
    options: ExciteCommandOptions,
    csv: Path = csv_option("Table of positions to write (.csv), for your own player."),
    page: Path = page_option("Page to write (.html): figures, plots, the arm in motion."),
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
                "file": None if trajectory is None else out,
                "csv": csv,
                "page": page,
                "robot": load_robot(options.robot).robot.name,
                "for": options.purpose,
                **designed.object,
                "warnings": [] if trajectory is None else trajectory.warnings,
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
