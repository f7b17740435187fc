"""Building blocks of a robot file's sections: checked numbers, and mappings that refuse unknown keys.

Some numbers only make sense up to a size: beyond it they are in degrees or mm.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from fractions import Fraction
from typing import Annotated, Any

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    WrapValidator,
)

from drivers.core.ranges import LENGTH, NUMBER, POSITION_LIMIT, POSITIVE, TABLE_ANGLE, VELOCITY_LIMIT, Range

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


Angle = Annotated[Finite, BeforeValidator(_parse_angle)]


class Section(BaseModel):
    """A mapping of the file; an unknown key is an error."""

    model_config = ConfigDict(defer_build=True, extra="forbid", frozen=True)


def multiple_of_pi(degrees: float) -> str:
    """An angle in degrees as a robot file's text in radians: `pi/2`, `-3*pi/4`, `2.96706`."""
    fraction = Fraction(degrees).limit_denominator(1000) / 180
    if abs(float(fraction) * 180 - degrees) > 1e-9 or fraction.denominator > 12:
        return f"{math.radians(degrees):.6g}"
    factor, divisor = abs(fraction.numerator), fraction.denominator
    if factor == 0:
        return "0"
    text = ("" if factor == 1 else f"{factor}*") + "pi" + ("" if divisor == 1 else f"/{divisor}")
    return f"-{text}" if fraction < 0 else text


def _table_angle(value: float) -> float:
    if not TABLE_ANGLE.holds(value):
        raise ValueError(
            f"{value:g} looks like degrees; angles are in rad, from -2π to 2π: {value:g}° is {multiple_of_pi(value)}"
        )
    return value


def _position_limit(value: Any, parse: ValidatorFunctionWrapHandler, info: ValidationInfo) -> Any:
    position = parse(value)
    if POSITION_LIMIT.holds(position) or (isinstance(value, str) and "pi" in value):
        return position
    if _slides(info):
        raise ValueError(
            f"{position:g} looks like millimetres; positions are in m: {position:g} mm is {position / 1e3:g}"
        )
    raise ValueError(
        f"{position:g} looks like degrees; positions are in rad: {position:g}° is {multiple_of_pi(position)}, "
        f"{position:g} rad would be {position / math.pi:.2f}*pi"
    )


def _velocity_limit(value: float, info: ValidationInfo) -> float:
    if VELOCITY_LIMIT.holds(value):
        return value
    if _slides(info):
        raise ValueError(
            f"{value:g} looks like mm/s; velocities are in m/s, up to {VELOCITY_LIMIT.most:g}: {value:g} mm/s is "
            f"{value / 1e3:.4g}"
        )
    raise ValueError(
        f"{value:g} looks like degrees per second; velocities are in rad/s, up to {VELOCITY_LIMIT.most:g}: "
        f"{value:g} °/s is {math.radians(value):.4g}"
    )


def _slides(info: ValidationInfo) -> bool:
    """Return whether the joint that these limits are of slides, by the context of the validation (`sliding`: names)."""
    return info.data.get("name") in (info.context or {}).get("sliding", ())


TableAngle = Annotated[Angle, AfterValidator(_table_angle)]
PositionLimit = Annotated[Angle, WrapValidator(_position_limit)]
VelocityLimit = Annotated[Positive, AfterValidator(_velocity_limit)]
