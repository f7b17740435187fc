"""The building blocks of what is computed and then written as it is: parts of a result, and numbers that JSON knows."""

from __future__ import annotations

import math
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict

from daq.robot.section import within
from ident.ranges import RESULT_VALUE


def finite_or_none(value: Any) -> Any:
    """A value as it is; None in place of infinity and NaN."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _nan_if_none(value: Any) -> Any:
    return math.nan if value is None else value


def _within_if_finite(value: float) -> float:
    return within(RESULT_VALUE)(value) if math.isfinite(value) else value


Value = Annotated[float, AfterValidator(within(RESULT_VALUE))]
Number = Annotated[Value | None, BeforeValidator(finite_or_none)]
"""A number; None where there is none (JSON knows no infinity and no NaN)."""

Real = Annotated[float, AfterValidator(_within_if_finite), BeforeValidator(_nan_if_none)]
"""A number to compute with; NaN where there is none. In the file, what is not finite is null."""


class Stored(BaseModel):
    """A part of a result: what a computation gives, and what the file holds."""

    model_config = ConfigDict(defer_build=True, frozen=True, extra="ignore")
