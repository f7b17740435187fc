"""What commands have in common that write a result and its report into a folder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from drivers.core.reading_process import Progress
    from ident.tasks.arguments import SavedResult

_Result = TypeVar("_Result", bound="SavedResult")


def check_result_folder(
    folder: Path | None, file: str, inputs: Sequence[object], robot: object, *, overwrite: bool
) -> None:
    """Check a command's folder before any work: the JSON file and the report; nothing where `folder` is None.

    Raises:
        UsageError: a file exists already or is one of the inputs, or the folder cannot be written.
    """
    from daq.output_files import REPORT_FILE, check_output_folder
    from daq.robot.loader import load_robot
    from ident.tasks.arguments import paths_of

    if folder is not None:
        read = [*paths_of(*inputs), *(load_robot(robot).files if robot else ())]  # type: ignore[arg-type]
        check_output_folder(folder, (file, REPORT_FILE), read, overwrite=overwrite)


def save_result(
    run: Callable[[Progress], _Result], folder: Path | None, word: str = "", *, overwrite: bool, as_json: bool
) -> _Result:
    """Run a task with its progress on standard error, and write its result into a folder, unless that is None.

    The first step is called `word`, where the task does not name its steps.
    """
    from daq.commands.console import progress_line

    with progress_line(quiet=as_json) as progress:
        if word:
            progress(word)
        result = run(progress)
        if folder is not None:
            progress("report")
            result.save(folder, overwrite=overwrite)
    return result


def print_files(folder: Path | None, file: str) -> None:
    """Say where the result and the report are."""
    from daq.output_files import REPORT_FILE

    if folder is not None:
        print(f"\n{folder / file}\n{folder / REPORT_FILE}")
