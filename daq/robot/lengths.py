"""Lengths that a robot file names once (`model.lengths`) and its frames refer to."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from drivers.core.validation import describe

_KEYS = ("b", "d", "r")


def with_lengths(content: Any) -> Any:
    """The content of `model` with the names of lengths in its frames replaced by their values; all else unchanged.

    Raises:
        ValueError: a frame refers to a length that is not there, or is not a number.
    """
    if not isinstance(content, dict) or not isinstance(content.get("lengths"), dict):
        return content
    lengths = content["lengths"]
    changed = dict(content)
    if isinstance(content.get("mdh"), list | tuple):
        changed["mdh"] = [_resolved(row, lengths) for row in content["mdh"]]
    if isinstance(content.get("loops"), list | tuple):
        changed["loops"] = [_resolved_loop(loop, lengths) for loop in content["loops"]]
    return changed


def _resolved_loop(loop: Any, lengths: Mapping[Any, Any]) -> Any:
    if not isinstance(loop, dict) or not isinstance(loop.get("closing"), list | tuple):
        return loop
    return {**loop, "closing": [_resolved(frame, lengths) for frame in loop["closing"]]}


def _resolved(frame: Any, lengths: Mapping[Any, Any]) -> Any:
    """A frame whose `b`, `d` and `r` are numbers."""
    if not isinstance(frame, dict):
        return frame
    resolved = dict(frame)
    for key in _KEYS:
        text = frame.get(key)
        if not isinstance(text, str):
            continue
        name = text.strip().removeprefix("-").strip()
        if name not in lengths:
            names = ", ".join(map(str, lengths)) or "none"
            raise ValueError(f"'{key}: {text}' refers to no length of 'lengths'; there are: {names}")
        value = lengths[name]
        if not isinstance(value, int | float) or isinstance(value, bool):
            raise ValueError(f"the length '{name}' is to be a number, found {describe(value)}")
        resolved[key] = -value if text.strip().startswith("-") else value
    return resolved
