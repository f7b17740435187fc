"""Models with one grade, of gravity and of servos, as a person or a program reads them."""

from __future__ import annotations

from pathlib import Path

from daq.commands.console import print_json
from daq.output_files import REPORT_FILE
from ident.commands.printing.result import print_tables
from ident.result.tables import Table
from ident.tasks.arguments import GradedResult


def print_identified(model: GradedResult, folder: Path, use: str, *, verbose: bool) -> None:
    """The verdict and the errors; with `verbose` every parameter."""
    print(model.verdict)
    print_tables([model.errors, *([model.parameters] if verbose else [])])
    print(f"\n{'' if verbose else 'Parameters with intervals: --verbose, or the report. '}{folder / REPORT_FILE}")
    print(f"next: {use}")


def print_validated(model: GradedResult, path: Path, errors: Table, *, as_json: bool) -> None:
    """The verdict on other recordings, and the errors; or both as a JSON object."""
    result = model.result
    if as_json:
        assert result.validation is not None
        print_json(
            {"result": path, "joints": result.joints, "validation": result.validation, "verdict": result.verdict}
        )
        return
    print(model.verdict)
    print_tables([errors])
