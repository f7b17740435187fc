"""Arguments and options that several commands share, and the values of their texts."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import typer

from daq.commands.options import FORCE as FORCE
from daq.commands.options import JSON as JSON
from drivers.core.errors import UsageError

ROBOT = typer.Argument(help="Built-in robot or robot file.")
ESSENTIAL = typer.Option(
    "rsd", "--essential", help="Which parameters leave the essential model: rsd (--significance) or f-test."
)
SIGNIFICANCE = typer.Option(15.0, "--significance", help="Threshold of the relative standard deviation [%].")


def _list_methods(text: str) -> str:
    """Print the methods and end, where asked for them."""
    if text == "help":
        from ident.estimators.method_choice import describe_methods

        print(describe_methods())
        raise typer.Exit
    return text


METHOD = typer.Option(
    "wls",
    "--method",
    metavar="NAME[:OPTION=VALUE]…",
    help="Estimator with its options, such as wls or energy:window=0.5; 'help' lists them.",
    callback=_list_methods,
    is_eager=True,
)
DELAY = typer.Option("auto", "--delay", help="Delay of torque behind position: auto, or SECONDS.")


ACCEPT = typer.Option(None, "--accept", help="YAML file of limits; exit status 1 where one is not kept.")
MAX_ERROR = typer.Option(None, "--max-error", help="Limit of the held-out relative error, a ratio such as 0.08.")
MAX_JOINT_ERROR = typer.Option(None, "--max-joint-error", help="The same for every joint by itself.")
MAX_RMSE = typer.Option(None, "--max-rmse", help="Limit of every joint's held-out RMSE [N·m or N].")


def limits_option(
    accept: Path | None, max_error: float | None, max_joint_error: float | None, max_rmse: float | None
) -> dict[str, Any] | None:
    """Limits of a file and of options, which go before the file's; None where there are none.

    Raises:
        UsageError: the file cannot be read, or a limit is wrong.
    """
    from ident.verdict.acceptance import declared, read_limits

    limits = {} if accept is None else read_limits(accept).model_dump(exclude_none=True)
    given = (
        ("--max-error", "relative_error", max_error),
        ("--max-joint-error", "joint_relative_error", max_joint_error),
        ("--max-rmse", "rmse", max_rmse),
    )
    for option, key, limit in given:
        if limit is not None:
            limits |= declared({key: limit}, option).model_dump(exclude_none=True)
    return limits or None


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


def names_option(text: str | None, option: str) -> tuple[str, ...] | None:
    """Names that commas separate; None where the option was not given.

    Raises:
        UsageError: there is no name in it.
    """
    if text is None:
        return None
    names = tuple(name for part in text.split(",") if (name := part.strip()))
    if not names:
        raise UsageError(f"{option} '{text}' holds no name")
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
