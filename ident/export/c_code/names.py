"""C names of a robot and its files, and texts that a C comment can hold."""

from __future__ import annotations

import re
import unicodedata
from pathlib import Path

from drivers.core.errors import UsageError

_FILE_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.+-]*")
_SUFFIXES = (".c", ".h")


def identifier(name: str) -> str:
    """A C identifier for a robot: lower case, no accents, `_` for what C does not allow, `arm` where nothing is left.

    What it gets behind itself (`_torque`) keeps it apart from C's keywords and library.
    """
    plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
    word = re.sub(r"[^a-z0-9]+", "_", plain.lower()).strip("_")
    if not word:
        return "arm"
    # Names with a digit in front are none; functions called is… or to… belong to the C library (C99 7.26).
    return f"arm_{word}" if re.match(r"[0-9]|is[a-z]|to[a-z]", word) else word


def comment_text(text: str) -> str:
    """A text that neither ends a comment nor makes a compiler warn, on one line."""
    visible = " ".join("".join(letter if letter.isprintable() else " " for letter in text).split())
    for mark in ("*/", "/*", "??", "\\"):
        while mark in visible:
            visible = visible.replace(mark, " ".join(mark) if len(mark) > 1 else "/ ")
    return visible


def source_paths(path: Path) -> tuple[Path, Path]:
    """Header and source that a path without suffix (or with .c or .h) means.

    Raises:
        UsageError: an #include cannot name that file.
    """
    stem = path.with_suffix("") if path.suffix in _SUFFIXES else path
    if not _FILE_NAME.fullmatch(stem.name):
        raise UsageError(
            f"'{stem.name}' is not a valid name for C files",
            hint="letters, digits, '_', '-', '+' and '.', as in --c arm",
        )
    return stem.with_name(f"{stem.name}.h"), stem.with_name(f"{stem.name}.c")
