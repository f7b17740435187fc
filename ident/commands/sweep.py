"""The command `dynid sweep`."""

from __future__ import annotations

from pathlib import Path

import typer

from ident.commands.options import FORCE, JSON, ROBOT
from ident.excite.sweep_choices import SweepChoices

app = typer.Typer()


@app.command("sweep")
def sweep_velocities(
    robot: str = ROBOT,
    out: Path = typer.Option(..., "-o", "--out", help="Trajectory file to write (.yaml)."),
    joints: str = typer.Option(None, "--joints", help="Joints that move, separated by commas; all if absent."),
    pose: str = typer.Option(None, "--pose", help="Pose of the robot file that the other joints rest in; its first."),
    stroke: float = typer.Option(SweepChoices.stroke, "--stroke", help="Of each joint [rad or m]."),
    slowest: float = typer.Option(SweepChoices.slowest, "--slowest", help="Peak of the slowest stroke [rad/s, m/s]."),
    speeds: int = typer.Option(SweepChoices.speeds, "--speeds", help="Number of peak speeds up to the limits."),
    prior: Path = typer.Option(None, "--prior", help="Model folder or result.json that predicts torque."),
    page: Path = typer.Option(None, "--page", help="Page to write (.html): plots, the arm in motion."),
    force: bool = FORCE,
    as_json: bool = JSON,
) -> None:
    """Design a motion for friction: one joint at a time, forth and back, its speed rising and falling again.

    Example: dynid sweep ur5e -o sweep.yaml --page sweep.html
    """
    from dataclasses import asdict

    from daq.commands.console import print_json, print_table, progress_line
    from daq.output_files import check_outputs, written_together
    from daq.robot.loader import load_robot
    from drivers.core.units import common_unit
    from ident.commands.options import names_option
    from ident.result.model import result_path
    from ident.tasks.velocity_sweep import design_sweep

    prior_file = None if prior is None else result_path(prior)
    check_outputs([out, page], [*load_robot(robot).files, prior_file], overwrite=force)
    with progress_line(quiet=as_json) as progress:
        progress("sweep")
        motion, done = design_sweep(
            robot,
            joints=names_option(joints, "--joints") or (),
            pose=pose,
            stroke=stroke,
            slowest=slowest,
            speeds=speeds,
            prior=prior_file,
        )
        with written_together():
            motion.save(out)
            if page is not None:
                progress("page")
                motion.page(page)
    if as_json:
        print_json(
            {
                "file": str(out),
                "page": None if page is None else str(page),
                "robot": motion.robot_file.robot.name,
                "duration": motion.duration,
                "joints": [asdict(one) for one in done],
                "warnings": list(motion.warnings),
            }
        )
        return
    rows = [
        (
            one.joint,
            one.low if one.speeds else None,
            one.high if one.speeds else None,
            one.speeds[0] if one.speeds else None,
            one.speeds[-1] if one.speeds else None,
            one.refusal,
        )
        for one in done
    ]
    sliding = motion.robot_file.robot.sliding
    title = f"Strokes [{common_unit('rad', sliding)}] and their peak velocities [{common_unit('rad/s', sliding)}]"
    print_table(title, ("joint", "from", "to", "slowest peak", "fastest peak", "does not move"), rows)
    print(
        f"\n{motion.duration:.0f} s; record it several times in a row, and the arm warms up from one to the next\n{out}"
    )
    if page is not None:
        print(page)
    for warning in motion.warnings:
        print(f"\nwarning: {warning}")
