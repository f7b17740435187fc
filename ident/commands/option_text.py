"""What the text of an option stands for, where several commands have the same one."""

from __future__ import annotations

import math

from drivers.errors import UsageError


def delay_option(text: str) -> float | None:
    """Delay [s] of `--delay`; None for `auto`.

    Raises:
        UsageError: neither a number nor `auto`.
    """
    if text == "auto":
        return None
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UsageError(f"--delay {text} is neither 'auto' nor a number of seconds")
    return value


def joints_option(text: str | None, option: str) -> tuple[str, ...] | None:
    """Names that commas separate; None where the option was not given.

    Raises:
        UsageError: there is no name in it.
    """
    if text is None:
        return None
    names = tuple(name for part in text.split(",") if (name := part.strip()))
    if not names:
        raise UsageError(f"{option} '{text}' names no joint")
    return names
