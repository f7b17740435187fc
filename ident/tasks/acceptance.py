"""Acceptance limits as an argument of a task: as keys, or as the path of a file with them."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

from ident.verdict.acceptance import AcceptanceLimits, declared, read_limits

Limits = Mapping[str, Any] | str | PathLike[str]
"""Limits by their keys (docs/identification.md), or the path of a YAML file with them."""


def limits_of(accept: Limits) -> AcceptanceLimits:
    """The limits, read where a path is given.

    Raises:
        UsageError: the file cannot be read, or a key is wrong.
    """
    return declared(accept, "accept") if isinstance(accept, Mapping) else read_limits(Path(accept))
