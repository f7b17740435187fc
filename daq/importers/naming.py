"""What the names in a file mean: `q1 [deg]`, `torque3`, `elbow_joint/position`, `data.q` → quantity, joint, unit."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from daq.importers.table import listed, printable
from daq.importers.units import REVOLUTE, SUFFIXES
from drivers.closest import did_you_mean
from drivers.errors import ImportFileError, UsageError
from drivers.units import normalised

ALIASES: Mapping[str, tuple[str, ...]] = {
    "time": ("t", "time", "timestamp", "timestamps", "stamp", "__time"),
    "position": ("q", "pos", "position", "positions", "jointpos", "joint_position", "joint_positions", "actual_q"),
    "velocity": (
        "qd",
        "dq",
        "qdot",
        "vel",
        "velocity",
        "velocities",
        "joint_velocity",
        "joint_velocities",
        "actual_qd",
    ),
    "torque": ("torque", "torques", "tau", "joint_torque", "joint_torques", "tau_j"),
    "current": ("i", "current", "currents", "motor_current", "joint_current", "joint_currents", "actual_current"),
    "effort": ("effort", "efforts"),
    "temperature": (
        "temp",
        "temperature",
        "temperatures",
        "joint_temperature",
        "joint_temperatures",
        "motor_temperature",
    ),
}
"""Quantity → what files call it; the case is ignored but for single letters."""

_QUANTITY = {alias: quantity for quantity, aliases in ALIASES.items() for alias in aliases} | {"I": "current"}
_NUMBERED = re.compile(r"^(.*?[^\d_\s\-])[_\s\-]?(?:(\d{1,3})|\[(\d{1,3})\]|\((\d{1,3})\))$")
_BRACKETED = re.compile(r"^(.*?)\s*(?:\[([^\[\]]*)\]|\(([^()]*)\))$")
_SEPARATORS = "_./:- "


@dataclass(frozen=True)
class Role:
    """What one name of a file means.

    Attributes:
        name: the file's name, as it stands there.
        quantity: `time`, `position`, `velocity`, `torque`, `current`, `effort` or `temperature`.
        number: as written, for `q3`; None otherwise.
        joint: the robot's joint, where the name carries it; None otherwise.
        unit: as the name states it; empty otherwise.
        exact: whether the whole name was understood, or only its last part (`data.q`).
    """

    name: str
    quantity: str
    number: int | None = None
    joint: str | None = None
    unit: str = ""
    exact: bool = True


def parse_name(name: str, joints: Sequence[str]) -> Role | None:
    """What a name means, given the robot's joint names; None for a name that means nothing to us."""
    stripped = name.strip()
    role = _parse_bare(stripped, joints)
    if role is None:
        match = _BRACKETED.match(stripped)
        if match is not None:
            role = _parse_bare(match[1], joints)
            unit = match[2] if match[2] is not None else match[3]
            role = None if role is None else replace(role, unit=unit.strip())
    if role is None and "_" in stripped:
        head, unit = stripped.rsplit("_", 1)
        role = _parse_bare(head, joints)
        if role is not None and normalised(unit) not in SUFFIXES & REVOLUTE.get(role.quantity, {}).keys():
            role = None
        role = None if role is None else replace(role, unit=unit)
    return None if role is None else replace(role, name=name)


def _parse_bare(name: str, joints: Sequence[str]) -> Role | None:
    role = _named(name, joints) or _whole_or_numbered(name)
    if role is not None:
        return role
    tail = re.split(r"[./]", name)[-1]
    role = _whole_or_numbered(tail) if tail != name else None
    return None if role is None else replace(role, exact=False)


def _quantity(alias: str) -> str | None:
    return _QUANTITY.get(alias) or (_QUANTITY.get(alias.casefold()) if len(alias) > 1 else None)


def _whole_or_numbered(name: str) -> Role | None:
    quantity = _quantity(name)
    if quantity is not None:
        return Role(name, quantity)
    match = _NUMBERED.match(name)
    quantity = _quantity(match[1]) if match is not None else None
    if match is None or quantity is None or quantity == "time":
        return None
    return Role(name, quantity, number=int(match[2] or match[3] or match[4]))


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
        parts = name.rsplit("/", 2)
        if len(parts) == 3 and parts[1] == joint:
            candidates.append(parts[2])
        for candidate in candidates:
            quantity = _quantity(candidate)
            if quantity is not None and quantity != "time":
                return Role(name, quantity, joint=joint)
    return None


def assign_roles(
    names: Sequence[str], joints: Sequence[str], columns: Mapping[str, str], where: str
) -> tuple[Role, ...]:
    """The names that are to be taken over, with their meaning; the user's `columns` go before any recognition.

    Args:
        names: of the file's columns or arrays.
        joints: the robot's joint names.
        columns: our name → the file's name, as the user gave them.
        where: the file, for messages.

    Raises:
        UsageError: a key of `columns` is none of our names.
        ImportFileError: a value of `columns` is not in the file, or two of the file's names mean the same.
    """
    chosen = tuple(_chosen_role(key, given, names, joints, where) for key, given in columns.items())
    decided = {role.quantity for role in chosen}
    recognised = [
        role for name in names if (role := parse_name(name, joints)) is not None and role.quantity not in decided
    ]
    full = {role.quantity for role in recognised if role.exact}
    # A column called exactly `t` beats one called `header.t`; among equals the user has to choose.
    recognised = [role for role in recognised if role.exact or role.quantity not in full]
    roles = (*chosen, *recognised)
    meanings: dict[tuple[str, int | None, str | None], Role] = {}
    for role in roles:
        meaning = (role.quantity, role.number, role.joint)
        other = meanings.setdefault(meaning, role)
        if other is not role:
            raise ImportFileError(
                f"'{printable(other.name)}' and '{printable(role.name)}' both mean {_meaning(role)}",
                where=where,
                hint=f"choose one, for example: --column {_our_name(role)}={printable(role.name)}",
            )
    return roles


def _chosen_role(key: str, given: str, names: Sequence[str], joints: Sequence[str], where: str) -> Role:
    role = parse_name(key, joints)
    if role is None or role.unit:
        raise UsageError(
            f"'{printable(key)}' is none of our column names",
            where="--column",
            hint="they are t, q1, qd1, torque1, current1, effort1, temperature1 and so on; q alone is a whole array",
        )
    matches = [name for name in names if name == given] or [
        name for name in names if (match := _BRACKETED.match(name.strip())) is not None and match[1] == given
    ]
    if not matches:
        raise ImportFileError(
            f"has no '{printable(given)}', which --column names for {key}; it has: {listed(names)}",
            where=where,
            hint=did_you_mean(given, names),
        )
    if len(matches) > 1:
        raise ImportFileError(f"has {len(matches)} columns called '{printable(given)}'", where=where)
    match = _BRACKETED.match(matches[0].strip())
    own = parse_name(matches[0], joints)
    unit = own.unit if own is not None else ""
    if not unit and match is not None:
        content = match[2] if match[2] is not None else match[3]
        unit = content if normalised(content) in REVOLUTE.get(role.quantity, {}) else ""
    return replace(role, name=matches[0], unit=unit, exact=True)


def _our_name(role: Role) -> str:
    short = {"time": "t", "position": "q", "velocity": "qd"}.get(role.quantity, role.quantity)
    return short if role.number is None else f"{short}{role.number}"


def _meaning(role: Role) -> str:
    if role.joint is not None:
        return f"the {role.quantity} of joint '{role.joint}'"
    return f"{role.quantity} {role.number}" if role.number is not None else f"the {role.quantity}"
