"""The command `dynid merge`."""

from __future__ import annotations

from pathlib import Path

import typer

from ident.commands.options import ESSENTIAL, FORCE, JSON, SIGNIFICANCE

app = typer.Typer()


@app.command("merge")
def merge_models(
    models: list[Path] = typer.Argument(help="result.json files of one arm, or the folders that hold them."),
    out: Path = typer.Option(Path("merged-model"), "-o", "--out", help="Folder for result.json and report.html."),
    validate_with: Path = typer.Option(None, "--validate", help="Held-out recording (.h5), used by none of them."),
    essential: str = ESSENTIAL,
    significance: float = SIGNIFICANCE,
    force: bool = FORCE,
    as_json: bool = JSON,
) -> None:
    """Merge models of one arm from several experiments, each weighted by its covariance, and test whether they agree.

    Example: dynid merge arm-model wrist-model --validate val.h5 -o merged
    """
    from daq.commands.console import progress_line
    from daq.output_files import REPORT_FILE, RESULT_FILE, check_output_folder
    from ident.commands.print_result import print_result
    from ident.result.model import result_path
    from ident.tasks.validation import merge

    inputs = [*map(result_path, models), validate_with]
    check_output_folder(out, (RESULT_FILE, REPORT_FILE), inputs, overwrite=force)
    with progress_line(quiet=as_json) as progress:
        progress("merging")
        merged = merge(
            models,
            validation=validate_with,
            essential=essential,  # type: ignore[arg-type]
            significance=significance,
        )
        progress("report")
        merged.save(out)
    if as_json:
        print(merged.to_json())
        return
    print_result(merged.result)
    print(f"\n{out / RESULT_FILE}\n{out / REPORT_FILE}")
