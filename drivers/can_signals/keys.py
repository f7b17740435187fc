"""Checking keys of a can_frames connection: every refusal says where, what was found and what is allowed."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from drivers.can.bus import EXTENDED
from drivers.can_signals.signals import Signal
from drivers.connection_keys import is_number, is_whole
from drivers.errors import UsageError

Section = Mapping[str, object]
Pick = Callable[[Section, str], Signal]
"""Makes a signal of an entry of the file, named by where it stands."""

STANDARD_LIMIT = 0x7FF
EXTENDED_LIMIT = 0x1FFFFFFF
_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = _SHORT.maxlong = 60


def wrong(key: str, value: object, allowed: str, where: str = "") -> UsageError:
    """The error of a key with a value that it cannot have."""
    found = "is missing" if value is None else f"is {_SHORT.repr(value)}"
    return UsageError(f"key '{key}' {found}", where=where or "can_frames connection", hint=f"allowed: {allowed}")


def mapping(value: object, where: str) -> Section:
    """A section of the file.

    Raises:
        UsageError: it is something else.
    """
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise UsageError(f"found {_SHORT.repr(value)}, but a mapping of keys should stand here", where=where)
    return value


def refuse_unknown(section: Section, known: Sequence[str], where: str) -> None:
    """Refuse keys that mean nothing.

    Raises:
        UsageError: names the key and those that there are.
    """
    for key in section:
        if key not in known:
            message = f"unknown key '{_SHORT.repr(key).strip(chr(39))}'"
            raise UsageError(message, where=where or "can_frames connection", hint=f"allowed: {', '.join(known)}")


def number(
    section: Section, key: str, where: str, low: float, high: float, unit: str, default: float | None = None
) -> float:
    """A number of a section within limits.

    Raises:
        UsageError: it is something else.
    """
    value = section.get(key, default)
    allowed = f"a number from {low:g} to {high:g}{f' {unit}' if unit else ''}"
    if not is_number(value, low, high):
        raise wrong(key, value, allowed, where)
    return float(value)


def whole(section: Section, key: str, where: str, low: int, high: int, default: int | None = None) -> int:
    """A whole number of a section within limits.

    Raises:
        UsageError: it is something else.
    """
    value = section.get(key, default)
    if not is_whole(value, low, high):
        raise wrong(key, value, f"a whole number from {low} to {high}", where)
    return value


def finite(section: Section, key: str, where: str, default: float) -> float:
    """A finite number of a section.

    Raises:
        UsageError: it is something else.
    """
    value: Any = section.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < math.inf:
        raise wrong(key, value, "a number", where)
    try:
        return float(value)
    except OverflowError:
        raise wrong(key, value, "a number", where) from None


def truth(section: Section, key: str, where: str, *, default: bool) -> bool:
    """A truth value of a section.

    Raises:
        UsageError: it is something else.
    """
    value = section.get(key, default)
    if not isinstance(value, bool):
        raise wrong(key, value, "true or false", where)
    return value


def text(section: Section, key: str, allowed: str, where: str = "") -> str:
    """A text of a section, not empty.

    Raises:
        UsageError: it is something else.
    """
    value = section.get(key)
    if not isinstance(value, str) or not value.strip():
        raise wrong(key, value, allowed, where)
    return value.strip()


def identifier(section: Section, key: str, where: str, *, allow_extended: bool) -> int:
    """An identifier of a frame; one above 11 bits gets `EXTENDED`.

    Raises:
        UsageError: it is something else.
    """
    value = section.get(key)
    limit = EXTENDED_LIMIT if allow_extended else STANDARD_LIMIT
    if not is_whole(value, 0, limit):
        more = "" if allow_extended else f"; with 'extended: true' up to 0x{EXTENDED_LIMIT:X}"
        raise wrong(key, value, f"0x0 to 0x{limit:X}, not in quotes{more}", where)
    return value | EXTENDED if value > STANDARD_LIMIT else value
