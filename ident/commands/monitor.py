"""The command `dynid monitor`: contacts in a recording, or live."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from daq.commands.help_text import CommandApp
from daq.commands.options import FORCE, JSON, takes
from ident.tasks.options import DetectionOptions

if TYPE_CHECKING:
    from ident.result.tables import Table

app = CommandApp("Use")

SHOWN = 15
"""Contacts that are printed at most, the strongest."""
REPLAY = "Replay"


@app.command("monitor")
@takes(DetectionOptions)
def monitor_command(
    *,
    model: Path = typer.Option(..., "--model", help="Folder that identify wrote, or its result.json."),
    replay: Path = typer.Option(..., "--replay", help="Recording (.h5) to watch.", rich_help_panel=REPLAY),
    contacts: Path = typer.Option(
        None, "--contacts", help="CSV (start,end in seconds) of contacts to find.", rich_help_panel=REPLAY
    ),
    options: DetectionOptions,
    page: Path = typer.Option(None, "--page", help="Page with plots to write (.html).", rich_help_panel=REPLAY),
    force: bool = FORCE,
    as_json: bool = JSON,
) -> None:
    """Find contacts by the external torque on every joint. No safety function.

    Example: dynid monitor --replay run.h5 --model model --page contacts.html
    """
    from daq.commands.console import print_json, progress_line
    from daq.output_files import check_outputs
    from ident.result.model import result_path
    from ident.tasks.arguments import paths_of
    from ident.tasks.monitoring import monitor

    check_outputs([page], [replay, result_path(model), contacts, *paths_of(options.quiet or ())], overwrite=force)
    with progress_line(quiet=as_json) as progress:
        progress("thresholds and external torque")
        watched = monitor(model, replay, contacts=contacts, **vars(options))
        if page is not None:
            progress("page")
            watched.page(page, overwrite=force)
    if as_json:
        print_json({**watched.to_dict(), "page": None if page is None else str(page)})
        return
    strongest = sorted(watched.contacts, key=lambda one: -one.ratio)[:SHOWN]
    _print(watched.summary, [index for index, one in enumerate(watched.contacts) if one in strongest])
    if len(watched.contacts) > SHOWN:
        print(f"the strongest {SHOWN} of {len(watched.contacts)} contacts; --json has all")
    elif not watched.contacts:
        print(f"no contact in {len(watched.time)} samples of {watched.label}")
    for table in (watched.comparison, watched.sensitivity):
        if table is not None:
            print()
            _print(table)
    print()
    print("\n".join(watched.explanation))
    if page is not None:
        print(f"\n{page}")


def _print(table: Table, rows: list[int] | None = None) -> None:
    from daq.commands.console import print_table

    chosen = [list(row.values()) for row in table]
    if rows is not None:
        chosen = [chosen[index] for index in rows]
    if chosen:
        print_table(table.title, [column.heading.replace("_", " ") for column in table.columns], chosen)
