"""The command `dynid info`."""

from __future__ import annotations

from pathlib import Path

import typer

from ident.commands.options import FORCE, JSON

app = typer.Typer()


@app.command("info")
def show_info(
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
    from daq.commands.console import progress_line
    from daq.output_files import check_output_folder
    from daq.robot.loader import load_robot
    from ident.checks.page.page import JSON_FILE, PAGE_FILE
    from ident.checks.recording_check import print_info
    from ident.tasks.recording_quality import info

    if page is not None:
        inputs = [recording, *(load_robot(robot).files if robot else ())]
        check_output_folder(page, (JSON_FILE, PAGE_FILE), inputs, overwrite=force)
    with progress_line(quiet=as_json) as progress:
        quality = info(recording, robot=robot, wanted_rsd=wanted_rsd, progress=progress)
        if page is not None:
            progress("page")
            quality.save(page)
    if as_json:
        print(quality.to_json())
        return
    print_info(quality.figures, quality.file)
    if page is not None:
        print(f"\n{page / JSON_FILE}\n{page / PAGE_FILE}")
