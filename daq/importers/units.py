"""Units that a file may state, and their conversion to SI (temperature in °C)."""

from __future__ import annotations

from collections.abc import Mapping

from drivers.core.units import conversion, factors, normalised

_ANGLE = factors("rad", "radian", "radians", "deg", "degree", "degrees")
_LENGTH = factors("m", "mm")

_TIME = factors("s", "sec", "ms", "us", "ns")
_ANGULAR_VELOCITY = factors(*(f"{unit}/s" for unit in _ANGLE), "rpm", "1/min")
_LINEAR_VELOCITY = factors(*(f"{unit}/s" for unit in _LENGTH))
_TORQUE = factors("nm", "mnm", "knm")
_FORCE = factors("n", "kn")

REVOLUTE: Mapping[str, Mapping[str, float]] = {
    "time": _TIME,
    "position": _ANGLE,
    "velocity": _ANGULAR_VELOCITY,
    "torque": _TORQUE,
    "current": factors("a", "ma"),
    "temperature": factors("degc", "c", "k"),
    "target_time": _TIME,
    "target_position": _ANGLE,
    "target_velocity": _ANGULAR_VELOCITY,
    "target_torque": _TORQUE,
    "gain_p": factors("nm/rad", "nm/deg"),
    "gain_d": factors("nms/rad", "nms/deg"),
}
"""Quantity → unit (as `normalised` spells it) → factor to SI; kelvin also has an offset, see `to_si`."""

PRISMATIC: Mapping[str, Mapping[str, float]] = {
    **REVOLUTE,
    "position": _LENGTH,
    "velocity": _LINEAR_VELOCITY,
    "torque": _FORCE,
    "target_position": _LENGTH,
    "target_velocity": _LINEAR_VELOCITY,
    "target_torque": _FORCE,
    "gain_p": factors("n/m"),
    "gain_d": factors("ns/m"),
}
"""The same for prismatic joints."""

SUFFIXES = frozenset({"deg", "rad", "s", "sec", "ms", "us", "ns", "nm", "a", "ma", "degc", "rpm"})
"""Units that are recognised after an underscore (`q1_deg`); `m` and `n` would be mistaken for names."""


def to_si(quantity: str, unit: str, *, prismatic: bool) -> tuple[float, float] | None:
    """Factor and offset so that SI = factor · value + offset; None for a unit that the quantity doesn't have."""
    spelled = normalised(unit)
    return conversion(spelled) if spelled in (PRISMATIC if prismatic else REVOLUTE).get(quantity, {}) else None


def allowed_units(quantity: str, *, prismatic: bool) -> str:
    """The units of a quantity, for a message."""
    return ", ".join((PRISMATIC if prismatic else REVOLUTE)[quantity])
