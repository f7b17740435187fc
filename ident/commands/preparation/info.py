"""The command `dynid info`."""

from __future__ import annotations

from pathlib import Path

from daq.commands.help_text import CommandApp
from daq.commands.options import FORCE, JSON, VERBOSE, page_option, takes
from ident.tasks.options import InfoOptions

app = CommandApp("Look")


@app.command("info")
@takes(InfoOptions)
def show_info(
    *,
    options: InfoOptions,
    page: Path = page_option("Folder for info.json and the page info.html."),
    verbose: bool = VERBOSE,
    force: bool = FORCE,
    as_json: bool = JSON,
) -> None:
    """Judge a recording: clocks, signals, excitation of the arm.

    Example: dynid info run.h5 --wanted-rsd 5 --page run-info
    """
    from daq.commands.console import progress_line
    from daq.output_files import check_output_folder
    from daq.robot.loader import load_robot
    from ident.commands.printing.checks import print_info
    from ident.tasks.arguments import paths_of
    from ident.tasks.recording_quality import RecordingQuality, info

    if page is not None:
        robot = options.robot
        inputs = [*paths_of(options.run), *(load_robot(robot).files if robot else ())]
        check_output_folder(page, (RecordingQuality.FILE, RecordingQuality.PAGE), inputs, overwrite=force)
    with progress_line(quiet=as_json) as progress:
        quality = info(**{**vars(options), "progress": progress})
        if page is not None:
            progress("page")
            quality.save(page, overwrite=force)
    if as_json:
        print(quality.to_json())
        return
    print_info(quality.figures, quality.file, verbose=verbose)
    if page is not None:
        print(f"\n{page / quality.FILE}\n{page / quality.PAGE}")
