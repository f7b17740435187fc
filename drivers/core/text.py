"""Texts: suggestions for misspelt names; counts; percentages as people write them (0.34 %, 12.5 %); strict JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from difflib import get_close_matches
from numbers import Integral
from pathlib import PurePath
from typing import Any

DASH = "–"
"""What stands for a missing value."""

LEAST_PERCENT, MOST_PERCENT = 0.001, 1e6
"""Percentages outside of these sizes are written as less or more than them."""


def did_you_mean(given: str, known: Iterable[str]) -> str:
    """'did you mean …?' with the closest known name, or an empty text."""
    matches = get_close_matches(given, list(known), n=1, cutoff=0.6)
    return f"did you mean '{matches[0]}'?" if matches else ""


def counted(count: float, noun: str) -> str:
    """A number of things whose plural ends in s, there or at `(s)`: 1 contact, 0.5 contacts, 2 frames dropped."""
    words = noun if "(s)" in noun else f"{noun}(s)"
    return f"{count if isinstance(count, Integral) else f'{count:g}'} {words.replace('(s)', '' if count == 1 else 's')}"


def first_few(texts: Sequence[str], most: int, separator: str = ", ") -> str:
    """The first texts, and how many more there are."""
    more = f" and {len(texts) - most} more" if len(texts) > most else ""
    return separator.join(texts[:most]) + more


def rounded(value: float) -> str:
    """A number of two significant digits, written out up to a million: 110, not 1.1e+02."""
    return f"{float(f'{value:.2g}'):g}"


def in_percent(ratio: float | None) -> float | None:
    """A ratio in percent; None where there is none."""
    return None if ratio is None or not math.isfinite(ratio) else 100.0 * ratio


def percent_text(ratio: float | None, digits: int = 3) -> str:
    """A ratio in percent, with its unit; a dash where there is none."""
    percentage = in_percent(ratio)
    return DASH if percentage is None else f"{percentage_text(percentage, digits)} %"


def percentage_text(percentage: float | None, digits: int = 3) -> str:
    """A percentage without its unit: `digits` significant digits, none after the point where none are left."""
    if percentage is None or not math.isfinite(percentage):
        return DASH
    size, sign = abs(percentage), "-" if percentage < 0 else ""
    if 0 < size < LEAST_PERCENT:
        return f"> {-LEAST_PERCENT:g}" if sign else f"< {LEAST_PERCENT:g}"
    if size >= MOST_PERCENT:
        return f"< -{MOST_PERCENT:.0f}" if sign else f"> {MOST_PERCENT:.0f}"
    if abs(size - round(size)) < 1e-9:
        return f"{sign}{size:.0f}"
    exponent = int(f"{size:.{digits - 1}e}".partition("e")[2])  # after rounding: 9.996 is 10.0
    return f"{sign}{size:.{max(0, digits - 1 - exponent)}f}"


def parsed_json(text: str | bytes) -> Any:
    """The value of a JSON text.

    Raises:
        ValueError: it is none, is nested too deeply, or holds an integer of more digits than Python reads.
    """
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("nested too deeply") from None


def json_text(content: Any) -> str:
    """The JSON text of an object: of dataclasses and models their fields; what is not a finite number becomes null."""
    return json.dumps(_plain(content), ensure_ascii=False, indent=1, allow_nan=False)


def _plain(content: Any) -> Any:
    """Return what JSON knows: paths as texts, arrays and tables as lists."""
    if isinstance(content, float):
        return content if math.isfinite(content) else None
    if content is None or isinstance(content, (str, int)):
        return content
    if isinstance(content, PurePath):
        return str(content)
    if isinstance(content, Mapping):
        return {str(key): _plain(value) for key, value in content.items()}
    for convert in ("model_dump", "tolist"):
        if hasattr(content, convert):
            return _plain(getattr(content, convert)())
    if isinstance(content, Iterable):
        return [_plain(entry) for entry in content]
    return {of.name: _plain(getattr(content, of.name)) for of in fields(content)}
