"""Units: as people write them and in SI (temperature in °C); those of joints, turning (N·m, rad) and sliding (N, m)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

ZERO_CELSIUS = 273.15
"""0 °C in kelvin."""

TURN = 2.0 * math.pi
"""[rad]."""
_DEGREE = TURN / 360.0
_ANGLE = {
    "rad": 1.0,
    "radian": 1.0,
    "radians": 1.0,
    "mrad": 1e-3,
    "urad": 1e-6,
    "deg": _DEGREE,
    "degree": _DEGREE,
    "degrees": _DEGREE,
    "mdeg": TURN / 360e3,
    "rev": TURN,
}
_LENGTH = {"m": 1.0, "mm": 1e-3}
_FAHRENHEIT = 5.0 / 9.0

FACTORS: Mapping[str, float] = (
    _ANGLE
    | _LENGTH
    | {f"{unit}/s": factor for unit, factor in (_ANGLE | _LENGTH).items()}
    | {f"{unit}/s^2": factor for unit, factor in _ANGLE.items()}
    | {"rpm": TURN / 60.0, "1/min": TURN / 60.0, "rpm/s": TURN / 60.0}
    | {"a": 1.0, "ma": 1e-3, "v": 1.0, "mv": 1e-3}
    | {"nm": 1.0, "mnm": 1e-3, "cnm": 1e-2, "knm": 1e3, "n": 1.0, "kn": 1e3}
    | {"degc": 1.0, "c": 1.0, "k": 1.0, "degf": _FAHRENHEIT, "f": _FAHRENHEIT}
    | {"nm/rad": 1.0, "nm/deg": 1.0 / _DEGREE, "nms/rad": 1.0, "nms/deg": 1.0 / _DEGREE, "n/m": 1.0, "ns/m": 1.0}
    | {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
    | {"1": 1.0, "": 1.0}
)
"""Unit, as `normalised` spells it → factor; some units of temperature also have an offset, see `conversion`."""

_OFFSETS = {"k": -ZERO_CELSIUS, "degf": -32.0 * _FAHRENHEIT, "f": -32.0 * _FAHRENHEIT}


def normalised(unit: str) -> str:
    """One spelling a unit: `N·m`, `N*m` and `Nm` are `nm`; `°/s` is `deg/s`; `rad/s²` is `rad/s^2`; `µs` is `us`."""
    text = unit.strip().replace("²", "^2").replace("**2", "^2")
    text = text.replace("°", "deg").replace("º", "deg").replace("µ", "u").replace("μ", "u").casefold()
    for character in "·*. ⋅":
        text = text.replace(character, "")
    return text


def factors(*units: str) -> Mapping[str, float]:
    """Those of the units that a quantity may have → factor, in this order."""
    return {unit: FACTORS[unit] for unit in units}


def conversion(unit: str) -> tuple[float, float]:
    """Factor and offset so that SI = factor · value + offset, for a unit as `normalised` spells it."""
    return FACTORS[unit], _OFFSETS.get(unit, 0.0)


def joint_unit(unit: str, *, sliding: bool) -> str:
    """The unit of a joint's own quantity, given that of a turning joint; N, m and kg for N·m, rad and kg·m²."""
    if not sliding:
        return unit
    for turning, straight in (("(N·m)", "N"), ("N·m", "N"), ("N*m", "N"), ("kg·m²", "kg"), ("rad", "m")):
        unit = unit.replace(turning, straight)
    return unit


def common_unit(unit: str, sliding: Iterable[bool]) -> str:
    """Unit of a column of several joints, "N·m or N" where some slide and others turn."""
    units = {joint_unit(unit, sliding=slides) for slides in sliding} or {unit}
    return " or ".join(sorted(units, key=lambda candidate: candidate != unit))
