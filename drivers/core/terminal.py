"""What a terminal is shown: text from files and controllers without the characters that would command the terminal."""

from __future__ import annotations

import codecs
import os
import re
import sys
from collections.abc import Iterable
from contextlib import suppress
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


def hidden_character(name: str) -> str:
    r"""The first character of a name that commands a terminal or ends a line, as `\u001b`; empty without one."""
    match = _COMMANDING.search(name) or re.search("[\t\n]", name)
    return f"\\u{ord(match.group()):04x}" if match else ""


LONGEST_NAME = 200
"""Characters of a name; some file formats hold no more than a few hundred."""


def unfit_name(name: str) -> str:
    """Why a text is no name of a joint, link or robot: `is empty`, `holds the character …`; empty where it is one."""
    if not name.strip():
        return "is empty"
    if len(name) > LONGEST_NAME:
        return f"has {len(name)} characters, more than {LONGEST_NAME}"
    return f"holds the character {hidden}" if (hidden := hidden_character(name)) else ""


def _escaped(error: UnicodeError) -> tuple[str, int]:
    r"""Error handler of an encoding: what it lacks as `\u00b5`, JSON's own escape, beyond 16 bits as a pair."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    pairs = error.object[error.start : error.end].encode("utf-16-be", "surrogatepass").hex()
    return "".join(f"\\u{pairs[at : at + 4]}" for at in range(0, len(pairs), 4)), error.end


codecs.register_error("dynid.escaped", _escaped)


class VisibleStream:
    """A text stream that writes `visible` text; all else is the stream's own."""

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
        """Hand out an attribute of the stream beneath."""
        return getattr(self.stream, name)


def open_standard_streams() -> None:
    """Open what was closed when the process started on nothing, or the next file would take its number."""
    for descriptor, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(descriptor)
        except OSError:
            nothing = os.open(os.devnull, os.O_RDWR)
            if nothing != descriptor:
                os.dup2(nothing, descriptor)
                os.close(nothing)
            os.set_inheritable(descriptor, True)  # or it is closed again in processes that this one starts
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(descriptor, mode, encoding="utf-8", closefd=False))


def drop_unwritten() -> None:
    """Drop what a standard stream holds and cannot write, or the interpreter would fail over it at the end."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError):
            with suppress(OSError, ValueError):
                nothing = os.open(os.devnull, os.O_WRONLY)
                os.dup2(nothing, stream.fileno())
                os.close(nothing)


def show_visibly() -> None:
    """Make whatever this process prints from now on visible; what draws on a terminal asks for `styled`.

    What the encoding of a stream lacks is escaped.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if not isinstance(stream, VisibleStream):
            if hasattr(stream, "reconfigure"):
                stream.reconfigure(errors="dynid.escaped")
            setattr(sys, name, VisibleStream(stream))


def styled(stream: TextIO) -> TextIO:
    """The stream beneath, for text with styles of ours; what comes from elsewhere must be made `visible` first."""
    return stream.stream if isinstance(stream, VisibleStream) else stream
