"""The command `dynid diff`."""

from __future__ import annotations

from pathlib import Path

import typer

from daq.commands.help_text import CommandApp
from daq.commands.options import JSON
from ident.tasks.options import MODEL_HELP

app = CommandApp("Use")


@app.command("diff")
def compare_models(
    first: Path = typer.Argument(help=MODEL_HELP),
    second: Path = typer.Argument(help="The same of another identification of this arm."),
    as_json: bool = JSON,
) -> None:
    """Compare two models of one arm: parameters, errors, checks.

    Example: dynid diff model-may model-june
    """
    from daq.commands.console import print_json
    from ident.commands.printing.result import print_tables
    from ident.tasks.difference import diff

    difference = diff(first, second)
    tables = {
        "parameters": difference.parameters,
        "errors": difference.errors,
        "purposes": difference.purposes,
        "checks": difference.checks,
    }
    if as_json:
        print_json(
            {
                "first": first,
                "second": second,
                "headline": difference.headline,
                "agree": difference.agree,
                "test": difference.test,
                "shared_recordings": difference.shared,
                **tables,
            }
        )
        return
    print(f"first: {first}\nsecond: {second}\n{difference.headline}")
    print_tables(tables.values())
