"""The command `dynid bench`."""

from __future__ import annotations

from pathlib import Path

import typer

from daq.commands.help_text import CommandApp
from daq.commands.options import FORCE, JSON, folder_option

app = CommandApp("Identify")


@app.command("bench")
def bench(
    datasets: str = typer.Option("", "--datasets", metavar="A,B,…", help="Names or YAML files; default: all."),
    methods: str = typer.Option(
        "", "--methods", metavar="A,B,…", help="Names, or your own module:function; default: all."
    ),
    data: Path = typer.Option(
        None, "--data", envvar="DYNID_DATA", help="Mirror folder with the files of the data sets."
    ),
    download: bool = typer.Option(False, "--download", help="Download missing files that have an address."),
    listed: bool = typer.Option(False, "--list", help="Only list data sets and methods."),
    out: Path = folder_option("benchmark.json"),
    scheduler: str = typer.Option("", "--scheduler", help="Judge on a Dask cluster (tcp://host:8786)."),
    force: bool = FORCE,
    as_json: bool = JSON,
) -> None:
    """Compare identification methods on public recordings, by one judge.

    A data set is a YAML file, a method a function: docs/benchmark.md.

    Example: dynid bench --data mirror --datasets ur10,panda --methods dynid,pinocchio-lstsq -o benchmark
    """
    from daq.commands.console import print_json, print_table, progress_line
    from daq.output_files import REPORT_FILE, check_output_folder
    from drivers.core.errors import UsageError
    from ident.benchmark.dataset import chosen_datasets, missing_files
    from ident.benchmark.entry import chosen_methods
    from ident.benchmark.results import BENCHMARK_FILE
    from ident.benchmark.run import run_benchmark
    from ident.commands.printing.result import print_tables

    names = [name.strip() for name in datasets.split(",") if name.strip()]
    if out is not None:
        given = [Path(name) for name in names if name.endswith((".yaml", ".yml"))]
        check_output_folder(out, (BENCHMARK_FILE, REPORT_FILE), given, overwrite=force)
    chosen = chosen_datasets(names)
    entries = chosen_methods(tuple(name.strip() for name in methods.split(",") if name.strip()))
    if listed:
        if as_json:
            print_json({"datasets": [of.model_dump(by_alias=True) for of in chosen], "methods": entries})
            return
        rows = [
            (of.name, of.title, of.source.licence, "" if data is None or missing_files(of, data) else "here")
            for of in chosen
        ]
        print_table("Data sets", ("name", "what", "licence", "files"), rows)
        print_table("Methods", ("name", "function"), list(entries.items()))
        return
    if data is None:
        raise UsageError("no folder with the data sets' files", hint="--data FOLDER, or DYNID_DATA; dynid bench --list")
    with progress_line(quiet=as_json) as progress:
        result = run_benchmark(chosen, entries, data, fetch=download, scheduler=scheduler, progress=progress)
        if out is not None:
            result.save(out, overwrite=force)
    if as_json:
        print(result.to_json())
    else:
        print_tables((result.losses, *result.tables))
        for failure in result.failures:
            print(failure)
        if out is not None:
            print(f"\n{out / BENCHMARK_FILE}\n{out / REPORT_FILE}")
    if all(entry.failure for entry in result.entries):
        raise typer.Exit(1)
