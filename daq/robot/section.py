"""Building blocks of a robot file's sections: checked numbers, and mappings that refuse unknown keys."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

from drivers.core.ranges import LENGTH, NUMBER, POSITIVE, Range

_PI_MULTIPLE = re.compile(r"^\s*([+-]?)\s*(?:(\d+(?:\.\d*)?)\s*\*\s*)?pi\s*(?:/\s*(\d+(?:\.\d*)?))?\s*$")


def _refuse_truth_value(value: Any) -> Any:
    # YAML reads yes, on and true as a boolean, and pydantic would read that as 1.
    if isinstance(value, bool):
        raise ValueError(f"found {str(value).lower()}, but it should be a number")
    return value


def within(allowed: Range) -> Callable[[float], float]:
    """A validator that refuses numbers out of a range."""

    def check(value: float) -> float:
        if not allowed.holds(value):
            raise ValueError(f"{value:g} is not within {allowed}")
        return value

    return check


NotTruthValue = BeforeValidator(_refuse_truth_value)
Finite = Annotated[float, Field(allow_inf_nan=False), AfterValidator(within(NUMBER)), NotTruthValue]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False), AfterValidator(within(POSITIVE)), NotTruthValue]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False), AfterValidator(within(NUMBER)), NotTruthValue]
Length = Annotated[Finite, AfterValidator(within(LENGTH))]
Place = tuple[Length, Length, Length]
Vector3 = tuple[Finite, Finite, Finite]


def _parse_angle(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    match = _PI_MULTIPLE.match(value)
    if match is None:
        return value
    sign, factor, divisor = match.groups()
    angle = math.pi * float(factor or 1)
    if divisor is not None:
        if float(divisor) == 0:
            raise ValueError("division by zero")
        angle /= float(divisor)
    return -angle if sign == "-" else angle


Angle = Annotated[float, Field(allow_inf_nan=False), NotTruthValue, BeforeValidator(_parse_angle)]


class Section(BaseModel):
    """A mapping of the file; an unknown key is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)
