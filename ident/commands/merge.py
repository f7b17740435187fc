"""The command `merge`."""

from __future__ import annotations

from pathlib import Path

import typer

app = typer.Typer()


@app.command("merge")
def merge_models(
    models: list[Path] = typer.Argument(help="result.json files of one arm, or the folders that hold them."),
    out: Path = typer.Option(Path("merged-model"), "-o", "--out", help="Folder for result.json and report.html."),
    validate_with: Path = typer.Option(None, "--validate", help="Held-out recording (.h5), used by none of them."),
    significance: float = typer.Option(
        15.0, "--significance", help="Threshold of the relative standard deviation [%]."
    ),
    as_json: bool = typer.Option(False, "--json", help="One JSON object on standard output, nothing else there."),
) -> None:
    """Merge models of one arm from several experiments, each weighted by its covariance, and test whether they agree.

    Example: dynid merge arm-model wrist-model --validate val.h5 -o merged
    """
    from daq.commands.console import progress_line
    from daq.recording.reader import read_recording
    from drivers.errors import UsageError
    from ident.commands.print_result import print_result
    from ident.experiments.merged_result import merge_results
    from ident.report import write_report
    from ident.result.schema import check_folder, read_result, result_json, write_result

    if not 0 < significance <= 100:
        raise UsageError(f"--significance {significance:g} is not a percentage", hint="the papers use 15")
    check_folder(out)
    paths = [path / "result.json" if path.is_dir() else path for path in models]
    if out / "result.json" in paths:
        raise UsageError(f"--out {out} holds one of the models to be merged", hint="name another folder")
    results = [(str(path), read_result(path)) for path in paths]
    held_out = read_recording(validate_with) if validate_with is not None else None
    with progress_line(quiet=as_json) as progress:
        progress("merging")
        merged, validated = merge_results(results, held_out, significance)
        progress("report")
        out.mkdir(parents=True, exist_ok=True)
        write_result(out / "result.json", merged)
        write_report(out / "report.html", merged, (), validated.series if validated is not None else ())
    if as_json:
        print(result_json(merged))
        return
    print_result(merged)
    print(f"\n{out / 'result.json'}\n{out / 'report.html'}")
