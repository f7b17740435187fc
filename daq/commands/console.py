"""What commands print: JSON objects for programs, tables for people."""

from __future__ import annotations

import math
import re
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from drivers.core.clock import SYSTEM_CLOCK
from drivers.core.terminal import styled, visible
from drivers.core.text import DASH, json_text, percentage_text

WIDTH_WITHOUT_TERMINAL = 160

SLOW_STEP = 2.0
"""How long [s] a step lasts before its progress is printed into a file or a pipe."""

SECONDS_BETWEEN_LINES = 5.0
"""Seconds between two lines on one step where standard error is no terminal: a log stays short."""

_NUMBER = re.compile(rf"(< )?[-+−±]?\d|{DASH}$|$")


def print_json(content: Any) -> None:
    """One JSON object on standard output; what is not a finite number becomes null."""
    print(json_text(content))


def print_table(title: str, headers: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """A table on standard output; the first column and columns of text to the left, numbers to the right."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(visible(title)) if title else None, title_justify="left", show_edge=False, pad_edge=False)
    listed = [
        [visible(cell(value, percentage="[%]" in header)) for header, value in zip(headers, row, strict=True)]
        for row in rows
    ]
    for column, header in enumerate(headers):
        number = column > 0 and all(_NUMBER.match(row[column]) for row in listed)
        table.add_column(Text(visible(header)), justify="right" if number else "left", overflow="fold")
    for row in listed:
        table.add_row(*map(Text, row))
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
    """Tells what is being done: a spinner where standard error is a terminal, elsewhere a line for each slow step."""
    from rich.console import Console
    from rich.text import Text

    console = Console(file=styled(sys.stderr), highlight=False)
    if quiet:
        yield lambda step: None
        return
    if not console.is_terminal:
        lines = _ProgressLines()
        try:
            yield lines.show
        finally:
            lines.end()
        return
    with console.status("…") as status:
        yield lambda step: status.update(Text(visible(step)))


class _ProgressLines:
    """Progress in a file or a pipe: a line for each step that is slow, with the seconds since the start."""

    def __init__(self) -> None:
        self._begin = self._last = SYSTEM_CLOCK.now()
        self._timer: threading.Timer | None = None

    def show(self, text: str) -> None:
        """Print a step if it lasts, and how far it is (a text that begins with a figure) every few seconds."""
        if text[:1].isdigit():
            if SYSTEM_CLOCK.now() - self._last >= SECONDS_BETWEEN_LINES:
                self._print(text)
            return
        self.end()
        if math.inf > SLOW_STEP:
            self._timer = threading.Timer(SLOW_STEP, self._print, [f"{text} …"])
            self._timer.daemon = True
            self._timer.start()

    def end(self) -> None:
        """No more is printed of the step that was begun last."""
        if self._timer is not None:
            self._timer.cancel()

    def _print(self, text: str) -> None:
        self._last = SYSTEM_CLOCK.now()
        print(f"{self._last - self._begin:5.0f} s  {text}", file=sys.stderr, flush=True)
