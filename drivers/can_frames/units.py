"""Units that a table of CAN signals may state, and what they are in SI (temperature in °C)."""

from __future__ import annotations

import math
from collections.abc import Mapping

_TURN = 2.0 * math.pi
_ANGLE = {
    "rad": 1.0,
    "mrad": 1e-3,
    "urad": 1e-6,
    "deg": _TURN / 360.0,
    "mdeg": _TURN / 360e3,
    "rev": _TURN,
}
_VELOCITY = {f"{unit}/s": factor for unit, factor in _ANGLE.items()} | {"rpm": _TURN / 60.0, "1/min": _TURN / 60.0}
_ACCELERATION = {f"{unit}/s^2": factor for unit, factor in _ANGLE.items()} | {"rpm/s": _TURN / 60.0}
_CURRENT = {"a": 1.0, "ma": 1e-3}
_TORQUE = {"nm": 1.0, "mnm": 1e-3, "cnm": 1e-2, "knm": 1e3}
_NONE = {"1": 1.0, "": 1.0}

FACTORS: Mapping[str, Mapping[str, float]] = {
    "position": _ANGLE,
    "velocity": _VELOCITY,
    "acceleration": _ACCELERATION,
    "current": _CURRENT,
    "voltage": {"v": 1.0, "mv": 1e-3},
    "torque": _TORQUE,
    "temperature": {"degc": 1.0, "c": 1.0, "k": 1.0, "degf": 5.0 / 9.0, "f": 5.0 / 9.0},
    "target_position": _ANGLE,
    "target_velocity": _VELOCITY,
    "target_acceleration": _ACCELERATION,
    "target_current": _CURRENT,
    "target_torque": _TORQUE,
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "counter": _NONE,
    "fault": _NONE,
}
"""Quantity → unit (as `normalised` spells it) → factor; a temperature's unit also has an offset, see `to_si`."""

_CELSIUS_AT_ZERO = {"k": -273.15, "degf": -32.0 * 5.0 / 9.0, "f": -32.0 * 5.0 / 9.0}


def normalised(unit: str) -> str:
    """One spelling a unit: `N·m`, `N*m` and `Nm` are `nm`; `°/s` is `deg/s`; `rad/s²` is `rad/s^2`."""
    text = unit.strip().replace("²", "^2").replace("**2", "^2")
    text = text.replace("°", "deg").replace("µ", "u").replace("μ", "u").casefold()
    for character in "·*. ⋅":
        text = text.replace(character, "")
    return text


def to_si(quantity: str, unit: str) -> tuple[float, float]:
    """Factor and offset so that SI = factor · value + offset.

    Raises:
        ValueError: the quantity does not have this unit; says which it may have.
    """
    allowed = FACTORS[quantity]
    spelled = normalised(unit)
    if spelled not in allowed:
        found = f"unit '{unit}'" if unit else "no unit"
        raise ValueError(f"{found} of {quantity} cannot be converted; allowed: {', '.join(filter(None, allowed))}")
    return allowed[spelled], _CELSIUS_AT_ZERO.get(spelled, 0.0) if quantity == "temperature" else 0.0
