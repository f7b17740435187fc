"""Roles of a file's columns or arrays: the user's choices first, then recognised names."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from daq.importers.naming import REVOLUTE, TIMES, Role, parse_name, parse_unit, split_unit
from daq.importers.table import listed, printable
from drivers.core.errors import ImportFileError, UsageError
from drivers.core.text import counted, did_you_mean
from drivers.core.units import normalised

PLACE = "{}"
"""Placeholder of the joints' numbers or names in a choice of several columns: `q{}`."""
_NUMBERS = re.compile(r"\s*\d{1,6}\s*(?:-\s*\d{1,6}\s*)?(?:,\s*\d{1,6}\s*(?:-\s*\d{1,6}\s*)?)*")


def assign_roles(
    names: Sequence[str], joints: Sequence[str], columns: Mapping[str, str], where: str, *, numbered: bool = False
) -> tuple[Role, ...]:
    """The names to import, with their meaning; the user's `columns` take precedence over recognition.

    Args:
        names: of the file's columns or arrays.
        joints: the robot's joint names.
        columns: our name → the file's name, a pattern such as `q{}`, or column numbers such as `2-7`.
        where: the file, for messages.
        numbered: whether the names are in an order that a user can count, from 1.

    Raises:
        UsageError: a key of `columns` is none of our names.
        ImportFileError: a value of `columns` is not in the file, or two of the file's names mean the same.
    """
    chosen = tuple(
        role
        for key, given in columns.items()
        for role in _chosen_roles(_meant(key, joints), key, given, names, joints, where, numbered)
    )
    decided = {role.quantity for role in chosen}
    recognised = [
        role for name in names if (role := parse_name(name, joints)) is not None and role.quantity not in decided
    ]
    full = {role.quantity for role in recognised if role.exact}
    # A column called exactly `t` beats one called `header.t`; among equals the user has to choose.
    recognised = [role for role in recognised if role.exact or role.quantity not in full]
    roles = (*chosen, *recognised)
    roles = (*roles, *_by_unit(names, roles, len(joints)))
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


def _by_unit(names: Sequence[str], roles: Sequence[Role], joints: int) -> Iterator[Role]:
    """Columns whose names are in no known words, but whose units leave one choice: a column for each joint."""
    taken, known = {role.name for role in roles}, {role.quantity for role in roles}
    if "effort" in known:
        known |= {"torque", "current"}
    members: dict[str, list[Role]] = {}
    for name in names:
        if name not in taken and (role := parse_unit(name)) is not None and role.quantity not in known:
            members.setdefault(role.quantity, []).append(role)
    for quantity, found in members.items():
        if len(found) == (1 if quantity in TIMES else joints) == len({role.number for role in found}):
            yield from found


def _meant(key: str, joints: Sequence[str]) -> Role:
    role = parse_name(key, joints)
    if role is None or role.unit:
        raise UsageError(
            f"'{printable(key)}' is not one of dynid's column names",
            where="--column",
            hint="these are t, q1, qd1, torque1, current1, effort1, temperature1, target_position1, target_time and so "
            "on; q alone is a whole array",
        )
    return role


def _chosen_roles(
    role: Role, key: str, given: str, names: Sequence[str], joints: Sequence[str], where: str, numbered: bool
) -> Iterator[Role]:
    """Columns of `--column KEY=GIVEN`: one name, those that a pattern fits, or column numbers."""
    whole = role.number is None and role.joint is None and role.quantity not in TIMES
    matches = _called(given, names)
    if len(matches) > 1:
        raise ImportFileError(f"has {counted(len(matches), 'column')} called '{printable(given)}'", where=where)
    if matches:
        yield _as_chosen(role, matches[0], joints)
    elif PLACE in given:
        if not whole or given.count(PLACE) > 1:
            raise UsageError(
                f"{printable(key)}={printable(given)}: a pattern has one {PLACE} and is for a whole quantity",
                where="--column",
                hint="for example --column position='q{}'",
            )
        yield from _fitting(role, key, given, names, joints, where)
    elif numbered and _NUMBERS.fullmatch(given):
        places = _column_numbers(given, len(names), where)
        if not whole and len(places) > 1:
            raise UsageError(
                f"{printable(key)}={printable(given)} gives one name to {counted(len(places), 'column')}",
                where="--column",
            )
        for joint_number, place in enumerate(places, start=1):
            name = names[place]
            if list(names).count(name) > 1:
                raise ImportFileError(f"has several columns called '{printable(name)}'; rename them", where=where)
            yield _as_chosen(replace(role, number=joint_number) if whole else role, name, joints)
    else:
        raise ImportFileError(
            f"has no '{printable(given)}', which --column names for {printable(key)}; it has: {listed(names)}",
            where=where,
            hint=did_you_mean(given, names),
        )


def _called(given: str, names: Sequence[str]) -> list[str]:
    """The names that are `given`, or that are it with a unit behind."""
    return [name for name in names if name == given] or [name for name in names if split_unit(name)[0] == given]


def _fitting(
    role: Role, key: str, pattern: str, names: Sequence[str], joints: Sequence[str], where: str
) -> Iterator[Role]:
    """The columns that a pattern means, by the joints' names or else by numbers."""
    named = {joint: columns for joint in joints if (columns := _called(pattern.replace(PLACE, joint), names))}
    before, after = pattern.split(PLACE)
    expression = re.compile(re.escape(before) + r"(\d{1,3})" + re.escape(after))
    numbered: dict[int, list[str]] = {}
    for name in names:
        fits = expression.fullmatch(name) or expression.fullmatch(split_unit(name)[0])
        if fits is not None:
            numbered.setdefault(int(fits[1]), []).append(name)
    for columns in (*named.values(), *numbered.values()):
        if len(columns) > 1:
            raise ImportFileError(
                f"several columns fit --column {printable(key)}={printable(pattern)} alike: {listed(columns)}",
                where=where,
            )
    if named:
        yield from (_as_chosen(replace(role, joint=joint), columns[0], joints) for joint, columns in named.items())
    elif numbered:
        yield from (
            _as_chosen(replace(role, number=joint_number), columns[0], joints)
            for joint_number, columns in sorted(numbered.items())
        )
    else:
        raise ImportFileError(
            f"has no column that fits --column {printable(key)}={printable(pattern)}; it has: {listed(names)}",
            where=where,
            hint=f"{PLACE} is a placeholder of the joints' numbers (from 1 or from 0) or names",
        )


def _column_numbers(given: str, count: int, where: str) -> list[int]:
    """Indices from 0 of the columns in a text such as `2-4,7`, which counts from 1."""
    places: list[int] = []
    for item in given.split(","):
        first, _, last = (text.strip() for text in item.partition("-"))
        low, high = int(first), int(last or first)
        if not 1 <= low <= high <= count:
            raise ImportFileError(
                f"has the columns 1 to {count}, but --column asks for {item.strip()}",
                where=where,
                hint="columns are counted from 1; a range goes upwards",
            )
        places += range(low - 1, high)
    return places


def _as_chosen(role: Role, name: str, joints: Sequence[str]) -> Role:
    """A role with this name and the unit that the name states."""
    own = parse_name(name, joints)
    unit = own.unit if own is not None else ""
    stated = split_unit(name)[1]
    if not unit and stated is not None and normalised(stated) in REVOLUTE.get(role.quantity, {}):
        unit = stated
    return replace(role, name=name, unit=unit, exact=True)


def _our_name(role: Role) -> str:
    short = {"time": "t", "position": "q", "velocity": "qd"}.get(role.quantity, role.quantity)
    return short if role.number is None else f"{short}{role.number}"


def _meaning(role: Role) -> str:
    if role.joint is not None:
        return f"the {role.quantity} of joint '{role.joint}'"
    return f"{role.quantity} {role.number}" if role.number is not None else f"the {role.quantity}"
