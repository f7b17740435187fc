"""The command `dynid info`."""

from __future__ import annotations

from pathlib import Path

import typer

from ident.commands.options import FORCE, JSON

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
    page: Path = typer.Option(None, "--page", help="Folder for info.json and info.html, a page to look at."),
    force: bool = FORCE,
    as_json: bool = JSON,
) -> None:
    """Show a recording's streams, clock and signal quality, and how well its motion excites the arm.

    Example: dynid info run.h5 --wanted-rsd 5 --page run-info
    """
    from daq.commands.console import print_json
    from daq.output_files import check_output_folder
    from daq.recording.reader import read_recording
    from daq.robot.loader import load_robot
    from ident.checks.page.page import JSON_FILE, PAGE_FILE, write_page
    from ident.checks.recording_check import info_object, print_info, recording_info

    if page is not None:
        inputs = [recording, *(load_robot(robot).files if robot else ())]
        check_output_folder(page, (JSON_FILE, PAGE_FILE), inputs, overwrite=force)
    read = read_recording(recording)
    checked = recording_info(read, load_robot(robot) if robot else read.robot(), wanted_rsd)
    if page is not None:
        write_page(page, checked, str(recording))
    if as_json:
        print_json(info_object(checked, str(recording)))
        return
    print_info(checked, str(recording))
    if page is not None:
        print(f"\n{page / JSON_FILE}\n{page / PAGE_FILE}")
