"""The commands `dynid history …`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from daq.commands.help_text import CommandApp, GroupedCommands
from daq.commands.options import FORCE, JSON, csv_option, page_option


class _ShownByDefault(GroupedCommands):
    """`dynid history arm.db` is `dynid history show arm.db`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put `show` before what begins with no command."""
        is_command = not args or args[0] in (*self.commands, *ctx.help_option_names)
        parsed: list[str] = super().parse_args(ctx, args if is_command else ["show", *args])
        return parsed


history_app = CommandApp("Use", cls=_ShownByDefault)
app = CommandApp("Use")
app.add_typer(history_app, name="history", rich_help_panel="Use")

MOST_SENTENCES = 5
MOST_ROWS = 8


@history_app.callback()
def history() -> None:
    """Follow an arm's parameters over many results: wear, steps, temperature.

    Example: dynid history arm.db
    """


@history_app.command("add")
def add(
    results: list[Path] = typer.Argument(help="Folders that identify wrote, or their result.json."),
    database: Path = typer.Option(..., "--history", help="File of the history (.db); created if it does not exist."),
    time: str = typer.Option(
        None, "--time", help="Time of the recording (2026-05-01T12:00, UTC), for a single result."
    ),
    as_json: bool = JSON,
) -> None:
    """Add results to a history; one that is there already is not added again.

    Example: dynid history add model --history arm.db
    """
    from daq.commands.console import print_json
    from drivers.core.errors import UsageError
    from drivers.core.text import counted
    from ident.tasks.history import History

    if time is not None and len(results) > 1:
        raise UsageError("--time needs a single result", hint="add them one by one")
    new = History(database).add(*results, time=time)
    if as_json:
        print_json({"history": str(database), "added": new, "there_already": len(results) - new})
        return
    there = f", {len(results) - new} there already" if new < len(results) else ""
    print(f"{database}: {counted(new, 'result')} added{there}\nnext: dynid history {database}")


@history_app.command("show")
def show(
    database: Path = typer.Argument(metavar="HISTORY", help="File of the history (.db)."),
    arm: str = typer.Option(None, "--arm", help="The arm, if the file holds several."),
    page: Path = page_option(),
    csv: Path = csv_option("CSV file to write: a row per parameter and result."),
    force: bool = FORCE,
    as_json: bool = JSON,
) -> None:
    """Show what changed of an arm: trends and steps of its parameters.

    Example: dynid history show arm.db --page wear.html
    """
    from daq.commands.console import print_json
    from daq.output_files import check_outputs
    from ident.commands.printing.result import print_tables
    from ident.tasks.history import History
    from ident.views.history_tables import date_text

    check_outputs([page, csv], [database], overwrite=force)
    trends = History(database).trend(arm)
    if page is not None:
        trends.page(page, overwrite=force)
    if csv is not None:
        trends.save_csv(csv, overwrite=force)
    of_arm = trends.history
    if as_json:
        print_json(
            {
                "history": database,
                "arm": of_arm.arm,
                "results": of_arm.results,
                "start": date_text(of_arm.start),
                "end": date_text(of_arm.end),
                "sentences": trends.sentences,
                "notes": trends.notes,
                "trends": trends.trends,
                "steps": trends.steps,
            }
        )
        return
    count = "1 result" if of_arm.results == 1 else f"{of_arm.results} results"
    print(f"{of_arm.arm}: {count}, {date_text(of_arm.start)} to {date_text(of_arm.end)}")
    for sentence in trends.sentences[:MOST_SENTENCES]:
        print(f"  {sentence}")
    if len(trends.sentences) > MOST_SENTENCES:
        print(f"  and {len(trends.sentences) - MOST_SENTENCES} more")
    shown = trends.trends.pick("name", "joint", "results", "start", "change", "change_half", "unit", "p_value")
    rows = [row for row, parameter in enumerate(of_arm.parameters) if parameter.trend is not None]
    print_tables([shown.in_order(rows[:MOST_ROWS])])
    for note in trends.notes:
        print(note)
