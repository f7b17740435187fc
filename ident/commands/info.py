"""The command `dynid info`."""

from __future__ import annotations

from pathlib import Path

import typer

from ident.commands.options import JSON

app = typer.Typer()


@app.command("info")
def info(
    recording: Path = typer.Argument(help="Recording (.h5)."),
    robot: str = typer.Option(None, "--robot", help="Robot file in place of the recording's own."),
    wanted_rsd: float = typer.Option(
        None,
        "--wanted-rsd",
        help="Estimate how long this motion must be recorded for this relative standard deviation [%].",
    ),
    as_json: bool = JSON,
) -> None:
    """Show a recording's streams, clock and signal quality, and how well its motion excites the arm.

    Example: dynid info run.h5 --wanted-rsd 5
    """
    from daq.commands.console import print_json
    from daq.recording.reader import read_recording
    from daq.robot.loader import load_robot
    from ident.checks.recording_check import info_object, print_info, recording_info

    read = read_recording(recording)
    checked = recording_info(read, load_robot(robot) if robot else read.robot(), wanted_rsd)
    if as_json:
        print_json(info_object(checked, str(recording)))
    else:
        print_info(checked, str(recording))
