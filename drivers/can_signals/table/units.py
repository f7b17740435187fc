"""Units that a table of CAN signals may state, and what they are in SI (temperature in °C)."""

from __future__ import annotations

from collections.abc import Mapping

from drivers.core.units import conversion, factors, normalised

_ANGLE = factors("rad", "mrad", "urad", "deg", "mdeg", "rev")
_VELOCITY = factors(*(f"{unit}/s" for unit in _ANGLE), "rpm", "1/min")
_ACCELERATION = factors(*(f"{unit}/s^2" for unit in _ANGLE), "rpm/s")
_CURRENT = factors("a", "ma")
_TORQUE = factors("nm", "mnm", "cnm", "knm")
_NONE = factors("1", "")

FACTORS: Mapping[str, Mapping[str, float]] = {
    "position": _ANGLE,
    "velocity": _VELOCITY,
    "acceleration": _ACCELERATION,
    "current": _CURRENT,
    "voltage": factors("v", "mv"),
    "torque": _TORQUE,
    "temperature": factors("degc", "c", "k", "degf", "f"),
    "target_position": _ANGLE,
    "target_velocity": _VELOCITY,
    "target_acceleration": _ACCELERATION,
    "target_current": _CURRENT,
    "target_torque": _TORQUE,
    "time": factors("s", "ms", "us", "ns"),
    "counter": _NONE,
    "fault": _NONE,
}
"""Quantity → unit, as `normalised` spells it → factor; a temperature's unit may have an offset too, see `to_si`."""


def to_si(quantity: str, unit: str) -> tuple[float, float]:
    """Factor and offset so that SI = factor · value + offset.

    Raises:
        ValueError: the quantity does not have this unit; says which it may have.
    """
    allowed = FACTORS[quantity]
    spelled = normalised(unit)
    if spelled not in allowed:
        given = f"unit '{unit}'" if unit else "no unit"
        raise ValueError(f"{given} of {quantity} cannot be converted; allowed: {', '.join(filter(None, allowed))}")
    return conversion(spelled)
