"""Numbers of a robot file that only make sense up to a size: beyond it they were written in degrees or millimetres."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Annotated, Any

from pydantic import AfterValidator, ValidatorFunctionWrapHandler, WrapValidator

from daq.robot.section import Angle, Positive
from drivers.core.ranges import POSITION_LIMIT, TABLE_ANGLE, VELOCITY_LIMIT


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


def _position_limit(value: Any, parse: ValidatorFunctionWrapHandler) -> Any:
    position = parse(value)
    if not POSITION_LIMIT.holds(position) and not (isinstance(value, str) and "pi" in value):
        raise ValueError(
            f"{position:g} looks like degrees, or like millimetres of a sliding joint; positions are in rad or m: "
            f"{position:g}° is {multiple_of_pi(position)}, {position:g} rad would be {position / math.pi:.2f}*pi"
        )
    return position


def _velocity_limit(value: float) -> float:
    if not VELOCITY_LIMIT.holds(value):
        raise ValueError(
            f"{value:g} looks like degrees per second, or like mm/s of a sliding joint; velocities are in rad/s or "
            f"m/s, up to {VELOCITY_LIMIT.most:g}: {value:g} °/s is {math.radians(value):.4g}"
        )
    return value


TableAngle = Annotated[Angle, AfterValidator(_table_angle)]
PositionLimit = Annotated[Angle, WrapValidator(_position_limit)]
VelocityLimit = Annotated[Positive, AfterValidator(_velocity_limit)]
