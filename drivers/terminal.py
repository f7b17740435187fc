"""What a terminal is shown: text from files and controllers without the characters that would command the terminal."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable
from typing import Any, TextIO

_COMMANDING = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f"  # control characters (C0 without tab and line feed, DEL, C1)
    "\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069"  # that change the direction of text
    "\u2028\u2029"  # that end a line
    "\ud800-\udfff]"  # halves of a pair, of a file's name that is no UTF-8; nothing can encode them
)


def visible(text: str) -> str:
    r"""The text with every character that commands a terminal, or cannot be printed, as `\u001b`.

    Line feeds and tabs stay. Within a string of a JSON text the escapes are JSON's own.
    """
    return _COMMANDING.sub(lambda match: f"\\u{ord(match.group()):04x}", text)


class VisibleStream:
    """A text stream that writes `visible` text; all else is the stream's own.

    Args:
        stream: that is written to.
    """

    def __init__(self, stream: TextIO) -> None:
        self.stream = stream

    def write(self, text: str) -> int:
        """Write the visible text; the number of characters that were given."""
        self.stream.write(visible(text))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write visible lines."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        """As the stream's own."""
        return getattr(self.stream, name)


def show_visibly() -> None:
    """From now on whatever this process prints is visible; what draws on a terminal asks for `styled`."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if not isinstance(stream, VisibleStream):
            setattr(sys, name, VisibleStream(stream))


def styled(stream: TextIO) -> TextIO:
    """The stream beneath, for text with styles of ours; what comes from elsewhere must be made `visible` first."""
    return stream.stream if isinstance(stream, VisibleStream) else stream
