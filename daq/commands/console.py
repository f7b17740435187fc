"""What commands print: JSON objects for programs, tables for people."""

from __future__ import annotations

import math
import re
import shutil
import sys
import textwrap
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import zip_longest
from typing import Any
from unicodedata import combining, east_asian_width

from drivers.core.clock import SYSTEM_CLOCK
from drivers.core.terminal import styled, visible
from drivers.core.text import DASH, json_text, percentage_text

WIDTH_WITHOUT_TERMINAL = 160

BETWEEN = " │ "
"""Between two columns of a table."""

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
    heads = [visible(header) for header in headers]
    listed = [
        [visible(cell(value, percentage="[%]" in header)) for header, value in zip(headers, row, strict=True)]
        for row in rows
    ]
    numbers = [column > 0 and all(_NUMBER.match(row[column]) for row in listed) for column in range(len(heads))]
    widths = [
        max(_width(line) for row in (heads, *listed) for line in row[column].split("\n"))
        for column in range(len(heads))
    ]
    # Into a file or a pipe tables keep their full width.
    columns = shutil.get_terminal_size().columns if sys.stdout.isatty() else WIDTH_WITHOUT_TERMINAL
    while sum(widths) + len(BETWEEN) * (len(widths) - 1) > columns and max(widths) > 1:
        widths[widths.index(max(widths))] -= 1
    if title:
        print(visible(title))
    for number, row in enumerate((heads, *listed)):
        wrapped = [_wrapped(text, width) for text, width in zip(row, widths, strict=True)]
        for line in zip_longest(*wrapped, fillvalue=""):
            aligned = [
                " " * (width - _width(text)) + text if right else text + " " * (width - _width(text))
                for text, width, right in zip(line, widths, numbers, strict=True)
            ]
            print((BETWEEN if number else " ┃ ").join(aligned).rstrip())
        if number == 0:
            print("━╇━".join("━" * width for width in widths))


def _width(text: str) -> int:
    """Columns of a terminal that a text takes."""
    return sum(0 if combining(letter) else 1 + (east_asian_width(letter) in "WF") for letter in text)


def _wrapped(text: str, width: int) -> list[str]:
    """Its lines, none longer than `width` letters; words that are longer are broken."""
    lines = [
        textwrap.wrap(line, width, break_on_hyphens=False) if len(line) > width else [line] for line in text.split("\n")
    ]
    return [part for line in lines for part in line]


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
    if quiet:
        yield lambda step: None
        return
    if not sys.stderr.isatty():
        lines = _ProgressLines()
        try:
            yield lines.show
        finally:
            lines.end()
        return
    from rich.console import Console
    from rich.text import Text

    console = Console(file=styled(sys.stderr), highlight=False)
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
