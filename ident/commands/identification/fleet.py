"""The command `dynid fleet`."""

from __future__ import annotations

from pathlib import Path

import typer

from daq.commands.help_text import CommandApp
from daq.commands.options import FORCE, JSON, out_option

app = CommandApp("Identify")

MOST_ROWS = 12


@app.command("fleet")
def fleet(
    file: Path = typer.Argument(metavar="FLEET_FILE", help="Arms, recordings and methods (.yaml; docs/fleet.md)."),
    out: Path = out_option("Folder of all results; an existing one is continued."),
    workers: int = typer.Option(None, "--workers", help="Number of processes; default: one per core."),
    scheduler: str = typer.Option("", "--scheduler", help="Dask scheduler to use instead (tcp://host:8786)."),
    history: Path = typer.Option(None, "--history", help="Add every result to this history (dynid history)."),
    force: bool = FORCE,
    as_json: bool = JSON,
) -> None:
    """Identify many recordings of many arms; a second call does what is missing.

    Example: dynid fleet fleet.yaml -o results
    """
    from daq.commands.console import progress_line
    from ident.commands.printing.result import print_tables
    from ident.fleet.fleet import identify_fleet
    from ident.history.database import check_history

    folder = out if out is not None else Path(f"{file.stem}-results")
    if history is not None:
        check_history(history)
    with progress_line(quiet=as_json) as progress:
        ended = identify_fleet(
            file, folder, workers=workers, scheduler=scheduler, history=history, overwrite=force, progress=progress
        )
    if as_json:
        print(ended.to_json())
    else:
        print(f"{ended.summary}; {ended.repeated} done now")
        if len(ended.results):
            print_tables([ended.results.in_order(range(min(MOST_ROWS, len(ended.results))))])
        for outcome in ended.failures[:MOST_ROWS]:
            print(f"failed: {outcome.name}: {outcome.failure}")
        print(f"\n{folder / 'report.html'}")
    if ended.failures:
        raise typer.Exit(1)
