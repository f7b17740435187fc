"""The command `dynid merge`."""

from __future__ import annotations

from pathlib import Path

from daq.commands.help_text import CommandApp
from daq.commands.options import FORCE, JSON, VERBOSE, folder_option, takes
from ident.tasks.options import MergeOptions

app = CommandApp("Identify")


@app.command("merge")
@takes(MergeOptions)
def merge_models(
    *,
    out: Path = folder_option("result.json", Path("merged-model")),
    options: MergeOptions,
    verbose: bool = VERBOSE,
    force: bool = FORCE,
    as_json: bool = JSON,
) -> None:
    """Merge models of one arm, each weighted by its covariance.

    Example: dynid merge arm-model wrist-model --validate val.h5 -o merged
    """
    from daq.output_files import REPORT_FILE, RESULT_FILE
    from ident.commands.printing.result import print_result
    from ident.commands.saving import check_result_folder, save_result
    from ident.result.models.model import result_path
    from ident.tasks.arguments import paths_of
    from ident.tasks.validation import merge

    inputs = [*map(result_path, paths_of(options.results)), options.validation]
    check_result_folder(out, RESULT_FILE, inputs, None, overwrite=force)
    merged = save_result(lambda _: merge(**vars(options)), out, "merging", overwrite=force, as_json=as_json)
    if as_json:
        print(merged.to_json())
        return
    print_result(merged.result, out / REPORT_FILE, verbose=verbose)
