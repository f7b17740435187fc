"""What commands print: JSON objects for programs, tables for people."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from drivers.core.terminal import styled, visible
from drivers.core.text import DASH, json_text, percentage_text

WIDTH_WITHOUT_TERMINAL = 160


def print_json(content: Any) -> None:
    """One JSON object on standard output; what is not a finite number becomes null."""
    print(json_text(content))


def print_table(title: str, headers: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """A table on standard output; the first column to the left, the others to the right."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(visible(title)) if title else None, title_justify="left", show_edge=False, pad_edge=False)
    for column, header in enumerate(headers):
        table.add_column(Text(visible(header)), justify="left" if column == 0 else "right", overflow="fold")
    for row in rows:
        cells = (cell(value, percentage="[%]" in header) for header, value in zip(headers, row, strict=True))
        table.add_row(*(Text(visible(text)) for text in cells))
    out = styled(sys.stdout)
    console = Console(file=out, highlight=False)
    # Into a file or a pipe tables keep their full width.
    width = console.width if console.is_terminal else WIDTH_WITHOUT_TERMINAL
    Console(file=out, highlight=False, width=width).print(table)


def cell(value: object, *, percentage: bool = False) -> str:
    """A value as a table shows it: four significant digits, percentages as people write them, a dash for nothing."""
    if isinstance(value, float) and percentage:
        return percentage_text(value)
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return DASH
    return f"{value:.4g}" if isinstance(value, float) else str(value)


@contextmanager
def progress_line(*, quiet: bool) -> Iterator[Callable[[str], None]]:
    """Tells what is being done: a spinner where standard error is a terminal, nothing elsewhere."""
    from rich.console import Console
    from rich.text import Text

    console = Console(file=styled(sys.stderr), highlight=False)
    if quiet or not console.is_terminal:
        yield lambda step: None
        return
    with console.status("…") as status:
        yield lambda step: status.update(Text(visible(step)))
