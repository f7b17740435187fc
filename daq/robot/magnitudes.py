"""Numbers of a robot file that only make sense up to a size: beyond it they are in degrees or mm."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Annotated, Any

from pydantic import AfterValidator, ValidationInfo, ValidatorFunctionWrapHandler, WrapValidator

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
    """Whether the joint that these limits are of slides, by the context of the validation (`sliding`: names)."""
    return info.data.get("name") in (info.context or {}).get("sliding", ())


TableAngle = Annotated[Angle, AfterValidator(_table_angle)]
PositionLimit = Annotated[Angle, WrapValidator(_position_limit)]
VelocityLimit = Annotated[Positive, AfterValidator(_velocity_limit)]
