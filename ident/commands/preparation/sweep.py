"""The command `dynid sweep`."""

from __future__ import annotations

from pathlib import Path

from daq.commands.help_text import CommandApp
from daq.commands.options import FORCE, JSON, out_option, page_option, takes
from ident.tasks.options import SweepOptions

app = CommandApp("Record")


@app.command("sweep")
@takes(SweepOptions)
def sweep_velocities(
    *,
    out: Path = out_option("Trajectory file to write (.yaml).", ...),
    options: SweepOptions,
    page: Path = page_option("Page to write (.html): plots, the arm in motion."),
    force: bool = FORCE,
    as_json: bool = JSON,
) -> None:
    """Design a motion for friction: one joint at a time, slow to fast.

    Example: dynid sweep ur5e -o sweep.yaml --page sweep.html
    """
    from daq.commands.console import print_json, print_table, progress_line
    from daq.output_files import check_outputs, written_together
    from daq.robot.loader import load_robot
    from drivers.core.units import common_unit
    from ident.result.models.model import result_path
    from ident.tasks.excitation import design_sweep

    prior_file = None if options.prior is None else result_path(options.prior)
    check_outputs([out, page], [*load_robot(options.robot).files, prior_file], overwrite=force)
    with progress_line(quiet=as_json) as progress:
        progress("sweep")
        motion, done = design_sweep(**vars(options))
        with written_together():
            motion.save(out, overwrite=force)
            if page is not None:
                progress("page")
                motion.page(page, overwrite=force)
    if as_json:
        print_json(
            {
                "file": out,
                "page": page,
                "robot": motion.robot_file.robot.name,
                "duration": motion.duration,
                "joints": done,
                "warnings": motion.warnings,
            }
        )
        return
    rows = [
        (
            sweep.joint,
            sweep.low if sweep.speeds else None,
            sweep.high if sweep.speeds else None,
            sweep.speeds[0] if sweep.speeds else None,
            sweep.speeds[-1] if sweep.speeds else None,
            sweep.refusal,
        )
        for sweep in done
    ]
    sliding = motion.robot_file.robot.sliding
    title = f"Strokes [{common_unit('rad', sliding)}] and their peak velocities [{common_unit('rad/s', sliding)}]"
    print_table(title, ("joint", "from", "to", "slowest peak", "fastest peak", "does not move"), rows)
    print(f"\n{motion.duration:.0f} s; record it several times in a row, while the arm warms up\n{out}")
    if page is not None:
        print(page)
    for warning in motion.warnings:
        print(f"\nwarning: {warning}")
