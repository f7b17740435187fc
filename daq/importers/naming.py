"""Meaning of the names in a file: `q1 [deg]`, `torque3`, `elbow_joint/position`, `data.q` → quantity, joint, unit."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

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

UNIT_QUANTITIES: Mapping[str, str] = {
    unit: quantity for quantity in ("time", "position", "velocity", "torque", "current") for unit in REVOLUTE[quantity]
}
"""Unit (as `normalised` spells it) → the quantity that a name in another language has, `Drehmoment 3 [Nm]`."""


def to_si(quantity: str, unit: str, *, prismatic: bool) -> tuple[float, float] | None:
    """Factor and offset so that SI = factor · value + offset; None for a unit that the quantity doesn't have."""
    spelled = normalised(unit)
    return conversion(spelled) if spelled in (PRISMATIC if prismatic else REVOLUTE).get(quantity, {}) else None


def allowed_units(quantity: str, *, prismatic: bool) -> str:
    """The units of a quantity, for a message."""
    return ", ".join((PRISMATIC if prismatic else REVOLUTE)[quantity])


ALIASES: Mapping[str, tuple[str, ...]] = {
    quantity: tuple(names.split())
    for quantity, names in {
        "time": "t time timestamp timestamps stamp __time",
        "position": "q pos position positions angle angles jointpos joint_position joint_positions actual_q",
        "velocity": "qd dq qdot vel velocity velocities speed speeds joint_velocity joint_velocities actual_qd",
        "torque": "torque torques trq tau joint_torque joint_torques tau_j",
        "current": "i cur curr current currents motor_current joint_current joint_currents actual_current",
        "effort": "effort efforts eff",
        "temperature": "temp temperature temperatures joint_temperature joint_temperatures motor_temperature",
        "target_time": "target_time target_times command_time command_times cmd_time",
        "target_position": (
            "target_position target_positions target_q q_target q_des q_cmd command commands commanded_position "
            "commanded_positions position_command position_commands goal_position goal_positions desired_position "
            "desired_positions"
        ),
        "target_velocity": (
            "target_velocity target_velocities target_qd qd_target qd_des qd_cmd commanded_velocity "
            "commanded_velocities velocity_command velocity_commands goal_velocity goal_velocities"
        ),
        "target_torque": (
            "target_torque target_torques commanded_torque commanded_torques torque_command torque_commands "
            "tau_cmd tau_ff"
        ),
        "gain_p": "gain_p",
        "gain_d": "gain_d",
    }.items()
}
"""Quantity → what files call it; the case is ignored but for single letters."""

TIMES = frozenset({"time", "target_time"})
"""Quantities of the whole arm: the stamps of the samples, and those of the commands."""

_QUANTITY = {alias: quantity for quantity, aliases in ALIASES.items() for alias in aliases} | {"I": "current"}
_MAGNITUDE = {f"{quantity}_magnitude": quantity for quantity in ("current", "torque", "effort")}
"""What files call a signal that has lost its sign."""
_NUMBERED = re.compile(r"^(.*?[^\d_\s\-])[_\s\-]?(?:(\d{1,3})|\[(\d{1,3})\]|\((\d{1,3})\))$")
_BRACKETED = re.compile(r"^(.*?)\s*(?:\[([^\[\]]*)\]|\(([^()]*)\))$")
"""A name with its unit: `q1 [deg]`, `I1 (A)`."""
_SEPARATORS = "_./:- "
_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d{1,3}")
_BETWEEN_WORDS = frozenset("_./:-# ")
_BRACKETED_NUMBER = re.compile(r"[\[(](\d{1,3})[\])]")
_JOINT_WORDS = frozenset({"joint", "joints", "jnt", "axis", "j", "a"})
_MEASURED_WORDS = frozenset({"actual", "act", "measured", "meas"})
_OWN_MEANING = frozenset(
    word for aliases in ALIASES.values() for alias in aliases for word in alias.split("_") if len(word) > 1
) - _JOINT_WORDS | {"motor", "error", "ref", "reference", "setpoint"}
"""Words that mean something else together than the unit says: the degrees of `Motor position 1` are the motor's."""
_MOTOR_QUANTITIES = frozenset({"current", "temperature"})
"""Quantities that a motor shares with its joint; with other values behind the gearbox."""


@dataclass(frozen=True)
class Role:
    """Meaning of one name of a file."""

    name: str  # the file's name, as written there
    quantity: str  # one of `ALIASES`
    number: int | None = None  # as written, for `q3`; None otherwise
    joint: str | None = None  # the robot's joint, where the name carries it; None otherwise
    unit: str = ""  # as the name states it; empty otherwise
    exact: bool = True  # whether the whole name was understood, or only its last component (`data.q`)
    magnitude: bool = False  # whether the name says that the values have lost their sign
    by_unit: bool = False  # whether only the unit gave the quantity


def split_unit(name: str) -> tuple[str, str | None]:
    """A name without the unit in brackets behind it, `q1 [deg]`, and that unit; None where it states none."""
    match = _BRACKETED.match(name.strip())
    if match is None:
        return name, None
    return match[1], (match[2] if match[2] is not None else match[3]).strip()


def parse_name(name: str, joints: Sequence[str]) -> Role | None:
    """Meaning of a name, given the robot's joint names; None for an unknown name."""
    stripped = name.strip()
    role = _parse_bare(stripped, joints)
    if role is None:
        bare, unit = split_unit(stripped)
        role = _parse_bare(bare, joints) if unit is not None else None
        role = None if role is None else replace(role, unit=unit or "")
    if role is None and "_" in stripped:
        head, unit = stripped.rsplit("_", 1)
        role = _parse_bare(head, joints)
        if role is not None and normalised(unit) not in SUFFIXES & REVOLUTE.get(role.quantity, {}).keys():
            role = None
        role = None if role is None else replace(role, unit=unit)
    return None if role is None else replace(role, name=name)


def parse_unit(name: str) -> Role | None:
    """Meaning of a name by its unit alone: `Moment 3 [Nm]`, `Zeit [s]`; None without one or without a number."""
    bare, unit = split_unit(name)
    if unit is None:
        return None
    quantity = UNIT_QUANTITIES.get(normalised(unit))
    if quantity == "time":
        return Role(name, quantity, unit=unit, by_unit=True)
    numbers, words = re.findall(r"\d+", bare), {word.casefold() for word in _WORD.findall(bare)}
    if quantity is None or len(numbers) != 1 or len(numbers[0]) > 3 or words & _OWN_MEANING:
        return None
    return Role(name, quantity, number=int(numbers[0]), unit=unit, by_unit=True)


def _parse_bare(name: str, joints: Sequence[str]) -> Role | None:
    worded = _in_words(name)
    role = (
        _named(name, joints) or _whole_or_numbered(name) or (worded if worded and worded.number is not None else None)
    )
    if role is not None:
        return role
    tail = re.split(r"[./]", name)[-1]
    role = (_whole_or_numbered(tail) if tail != name else None) or worded
    return None if role is None else replace(role, exact=False)


def _quantity(alias: str) -> str | None:
    if len(alias) > 1:
        alias = alias.casefold()
    return _QUANTITY.get(alias) or _MAGNITUDE.get(alias)


def _role(name: str, alias: str, quantity: str, *, number: int | None = None, joint: str | None = None) -> Role:
    return Role(name, quantity, number, joint, magnitude=alias.casefold() in _MAGNITUDE)


def _whole_or_numbered(name: str) -> Role | None:
    quantity = _quantity(name)
    if quantity is not None:
        return _role(name, name, quantity)
    match = _NUMBERED.match(name)
    quantity = _quantity(match[1]) if match is not None else None
    if match is None or quantity is None or quantity in TIMES:
        return None
    return _role(name, match[1], quantity, number=int(match[2] or match[3] or match[4]))


def _in_words(name: str) -> Role | None:
    """`Joint 1 position`, `J1_pos`, `Axis1ActualVelocity`, `Motor current 3`: a quantity, and at most one number."""
    plain = _BRACKETED_NUMBER.sub(r" \1 ", name)
    words = _WORD.findall(plain)
    if not set(_WORD.sub("", plain)) <= _BETWEEN_WORDS:
        return None
    digits = [word for word in words if word.isdigit()]
    spelled = {word if len(word) == 1 else word.casefold() for word in words if not word.isdigit()}
    quantities = [word for word in spelled if word.casefold() not in _JOINT_WORDS | _MEASURED_WORDS and word != "motor"]
    if len(digits) > 1 or len(quantities) != 1:
        return None
    quantity = _quantity(quantities[0])
    if quantity is None or quantity in TIMES or ("motor" in spelled and quantity not in _MOTOR_QUANTITIES):
        return None
    return Role(name, quantity, number=int(digits[0]) if digits else None)


def _named(name: str, joints: Sequence[str]) -> Role | None:
    """`position_elbow`, `elbow.position`, `position[elbow]`, `/joint_states/elbow/position`."""
    for joint in sorted(joints, key=len, reverse=True):
        candidates = []
        if name.endswith(f"[{joint}]"):
            candidates.append(name[: -len(joint) - 2])
        if len(name) > len(joint) + 1:
            if name.startswith(joint) and name[len(joint)] in _SEPARATORS:
                candidates.append(name[len(joint) + 1 :])
            if name.endswith(joint) and name[-len(joint) - 1] in _SEPARATORS:
                candidates.append(name[: -len(joint) - 1])
        components = name.rsplit("/", 2)
        if len(components) == 3 and components[1] == joint:
            candidates.append(components[2])
        for candidate in candidates:
            quantity = _quantity(candidate)
            if quantity is not None and quantity not in TIMES:
                return _role(name, candidate, quantity, joint=joint)
    return None
