"""Units that a file may state, and what they are in SI (temperature in °C)."""

from __future__ import annotations

import math
from collections.abc import Mapping

_DEGREE = math.pi / 180
_ANGLE = {"rad": 1.0, "radian": 1.0, "radians": 1.0, "deg": _DEGREE, "degree": _DEGREE, "degrees": _DEGREE}
_LENGTH = {"m": 1.0, "mm": 1e-3}

REVOLUTE: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "position": _ANGLE,
    "velocity": {
        **{f"{unit}/s": factor for unit, factor in _ANGLE.items()},
        "rpm": math.pi / 30,
        "1/min": math.pi / 30,
    },
    "torque": {"nm": 1.0, "mnm": 1e-3, "knm": 1e3},
    "current": {"a": 1.0, "ma": 1e-3},
    "temperature": {"degc": 1.0, "c": 1.0, "k": 1.0},
}
"""Quantity → unit (as `normalised` spells it) → factor to SI; kelvin also has an offset, see `to_si`."""

PRISMATIC: Mapping[str, Mapping[str, float]] = {
    **REVOLUTE,
    "position": _LENGTH,
    "velocity": {f"{unit}/s": factor for unit, factor in _LENGTH.items()},
    "torque": {"n": 1.0, "kn": 1e3},
}
"""The same for prismatic joints."""

SUFFIXES = frozenset({"deg", "rad", "s", "sec", "ms", "us", "ns", "nm", "a", "ma", "degc", "rpm"})
"""Units that are recognised after an underscore (`q1_deg`); `m` and `n` would be mistaken for names."""


def normalised(unit: str) -> str:
    """One spelling a unit: `N·m`, `N*m` and `Nm` are `nm`; `°/s` is `deg/s`; `µs` is `us`."""
    text = unit.strip().replace("°", "deg").replace("º", "deg").replace("µ", "u").replace("μ", "u").casefold()
    for character in "·*. ⋅":
        text = text.replace(character, "")
    return text


def to_si(quantity: str, unit: str, *, prismatic: bool) -> tuple[float, float] | None:
    """Factor and offset so that SI = factor · value + offset; None for a unit that the quantity doesn't have."""
    spelled = normalised(unit)
    factor = (PRISMATIC if prismatic else REVOLUTE).get(quantity, {}).get(spelled)
    if factor is None:
        return None
    return factor, -273.15 if quantity == "temperature" and spelled == "k" else 0.0


def allowed_units(quantity: str, *, prismatic: bool) -> str:
    """The units of a quantity, for a message."""
    return ", ".join((PRISMATIC if prismatic else REVOLUTE)[quantity])
