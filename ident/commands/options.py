"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer


def _list_methods(text: str) -> str:
    """Print the methods and end, where asked for them."""
    if text == "help":
        from ident.estimators.method_choice import describe_methods

        print(describe_methods())
        raise typer.Exit
    return text


METHOD = {"callback": _list_methods, "is_eager": True}
"""What `--method` does beside: 'help' lists the methods."""

ACCEPT = typer.Option(
    None, "--accept", help="YAML file of limits; exit status 1 where one is not kept.", rich_help_panel="Acceptance"
)
MAX_ERROR = typer.Option(
    None,
    "--max-error",
    help="Limit of the held-out relative error, a ratio such as 0.08.",
    rich_help_panel="Acceptance",
)
MAX_JOINT_ERROR = typer.Option(
    None, "--max-joint-error", help="The same for every joint by itself.", rich_help_panel="Acceptance"
)
MAX_RMSE = typer.Option(
    None, "--max-rmse", help="Limit of every joint's held-out RMSE [N·m or N].", rich_help_panel="Acceptance"
)


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
