"""The command `dynid compare`."""

from __future__ import annotations

from pathlib import Path

from daq.commands.help_text import CommandApp
from daq.commands.options import FORCE, JSON, folder_option, takes
from drivers.core.errors import UsageError
from ident.tasks.options import CompareOptions

app = CommandApp("Identify")


@app.command("compare")
@takes(CompareOptions)
def compare_methods(
    *, options: CompareOptions, out: Path = folder_option("comparison.json"), force: bool = FORCE, as_json: bool = JSON
) -> None:
    """Compare methods and friction models on held-out recordings.

    Example: dynid compare run.h5 --methods ols,wls --validate val-1.h5 --validate val-2.h5 -o comparison
    """
    from daq.output_files import RESULT_FILE
    from ident.commands.printing.result import print_tables
    from ident.commands.saving import check_result_folder, print_files, save_result
    from ident.tasks.arguments import paths_of
    from ident.tasks.comparison import COMPARISON_FILE, compare

    for path in paths_of(options.runs):
        if (path / RESULT_FILE).is_file():
            raise UsageError("is a model, not a recording", where=str(path), hint="two models: dynid diff FIRST SECOND")
    check_result_folder(out, COMPARISON_FILE, [options.runs, options.validation], options.robot, overwrite=force)
    comparison = save_result(
        lambda progress: compare(**{**vars(options), "progress": progress}), out, overwrite=force, as_json=as_json
    )
    if as_json:
        print(comparison.to_json())
        return
    print_tables((comparison.errors, comparison.maxima, comparison.differences))
    for failure in comparison.failures:
        print(failure)
    print_files(out, COMPARISON_FILE)
