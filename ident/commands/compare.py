"""The command `dynid compare`."""

from __future__ import annotations

from pathlib import Path

import typer

from ident.commands.options import DELAY, FORCE, JSON

app = typer.Typer()


@app.command("compare")
def compare_methods(
    recordings: list[Path] = typer.Argument(help="Recordings (.h5) of one arm; several are stacked."),
    methods: str = typer.Option("ols,wls", "--methods", metavar="A,B,…", help="Methods, as identify takes them."),
    friction: str = typer.Option(
        None, "--friction", metavar="A,B,…", help="Friction models, as identify takes them; each with each method."
    ),
    validate_with: list[Path] = typer.Option([], "--validate", help="Held-out recordings; the last 30 % without any."),
    split: float = typer.Option(None, "--split", help="Identify on the first SECONDS, validate on the rest."),
    robot: str = typer.Option(None, "--robot", help="Robot file in place of the recording's own."),
    delay: str = DELAY,
    out: Path = typer.Option(None, "-o", "--out", help="Folder for comparison.json and report.html."),
    force: bool = FORCE,
    as_json: bool = JSON,
) -> None:
    """Identify with several methods and compare their errors on the same held-out recordings.

    Example: dynid compare run.h5 --methods ols,wls --validate val-1.h5 --validate val-2.h5 -o comparison
    """
    from daq.commands.console import print_table, progress_line
    from daq.output_files import REPORT_FILE, check_output_folder
    from daq.robot.loader import load_robot
    from ident.commands.options import delay_option, names_option
    from ident.tasks.comparison import COMPARISON_FILE, compare

    if out is not None:
        inputs = [*recordings, *validate_with, *(load_robot(robot).files if robot else ())]
        check_output_folder(out, (COMPARISON_FILE, REPORT_FILE), inputs, overwrite=force)
    with progress_line(quiet=as_json) as progress:
        comparison = compare(
            recordings,
            names_option(methods, "--methods") or (),
            friction=names_option(friction, "--friction") or (),
            validation=validate_with,
            robot=robot,
            delay=delay_option(delay),
            split=split,
            progress=progress,
        )
        if out is not None:
            progress("report")
            comparison.save(out)
    if as_json:
        print(comparison.to_json())
        return
    for table in (comparison.errors, comparison.maxima, comparison.differences):
        if len(table):
            headings = [column.heading.replace("_", " ") for column in table.columns]
            print_table(f"\n{table.title}", headings, [list(row.values()) for row in table])
    for failure in comparison.failures:
        print(failure)
    if out is not None:
        print(f"\n{out / COMPARISON_FILE}\n{out / REPORT_FILE}")
