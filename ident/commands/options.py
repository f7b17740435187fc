"""Arguments and options that several commands share, and the values of their texts."""

from __future__ import annotations

import math

import typer

from drivers.errors import UsageError

JSON = typer.Option(False, "--json", help="One JSON object on standard output, nothing else there.")
ROBOT = typer.Argument(help="Built-in robot or robot file.")
SIGNIFICANCE = typer.Option(15.0, "--significance", help="Threshold of the relative standard deviation [%].")
DELAY = typer.Option("auto", "--delay", help="Delay of torque behind position: auto, or SECONDS.")


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


def numbers_option(text: str | None, option: str) -> tuple[float, ...] | None:
    """Numbers that commas separate; None where the option was not given.

    Raises:
        UsageError: they are not numbers.
    """
    if text is None:
        return None
    try:
        return tuple(float(value) for value in text.split(","))
    except ValueError:
        raise UsageError(f"'{text}' are not numbers separated by commas", where=option) from None
