"""Collect named arrays into a `Table`: columns are gathered by quantity, (N, n) each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from daq.importers.naming import TIMES, Role
from daq.importers.table import ForeignTable, Note, QuantityColumns, listed, printable
from drivers.core.arrays import FloatArray
from drivers.core.errors import ImportFileError
from drivers.core.terminal import hidden_character
from drivers.core.text import counted
from drivers.streams import COMMANDS

_FLOAT_INTEGERS = 2**53
"""Integers up to here are exact in float64."""

MOST_UNUSED = 1000
"""Most names that one message lists of what was not imported; realistic files have fewer."""

ARM_WIDE = frozenset({"current", "temperature", *COMMANDS})
"""Quantities that a file may have once for the whole arm; such a column is not imported."""


def collect(
    source: str,
    roles: Sequence[Role],
    arrays: Mapping[str, npt.NDArray[Any]],
    joints: Sequence[str],
    where: str,
    *,
    array_joints: tuple[str, ...] | None = None,
    units: Mapping[str, str] | None = None,
    unused: Sequence[str] = (),
    notes: Sequence[Note] = (),
    lines: npt.NDArray[np.int64] | None = None,
) -> ForeignTable:
    """Gather arrays into a table.

    Args:
        source: kind of the file, in words.
        roles: meaning of the names.
        arrays: the file's name → (N,), (N, 1), (1, N), (N, n) or (n, N) numbers.
        joints: the robot's joint names.
        where: the file, for messages.
        array_joints: the joint names that the file gives for the columns of its (N, n) arrays.
        units: the file's name → unit, where the file states it elsewhere than in the name.
        unused: names in the file that mean nothing to us.
        notes: assumptions of the reader.
        lines: (N,) line number of each sample.

    Raises:
        ImportFileError: an array of another shape or type, a missing or surplus joint, two sources of one quantity,
            a control character in a name.
    """
    for name in (*arrays, *unused, *(array_joints or ())):
        if hidden := hidden_character(name):
            raise ImportFileError(
                f"the name '{printable(name)}' holds the character {hidden}", where=where, hint="rename it in the file"
            )
    units = units or {}
    notes = list(notes)
    unused = list(unused)
    stamps: dict[str, tuple[FloatArray, str]] = {}
    groups: dict[str, list[tuple[Role, FloatArray]]] = {}
    width = len(array_joints) if array_joints is not None else len(joints)
    origin = next((_origin(arrays[role.name], notes) for role in roles if role.quantity == "time"), None)
    for role in roles:
        raw = arrays[role.name]
        if role.quantity in TIMES:
            raw = _since(raw, origin)
        values = _numbers(raw, role.name, where)
        unit = role.unit or units.get(role.name, "")
        if role.quantity in TIMES:
            stamps[role.quantity] = _vector(values, role.name, where), unit
            continue
        single = values.size == max(values.shape, default=0)
        if role.number is None and role.joint is None and width > 1 and single and role.quantity in ARM_WIDE:
            unused.append(role.name)
            continue
        groups.setdefault(role.quantity, []).append((replace(role, unit=unit), values))
    quantities = {}
    for quantity, members in groups.items():
        whole = [role for role, _ in members if role.number is None and role.joint is None]
        if whole and len(members) > 1:
            others = listed(role.name for role, _ in members if role is not whole[0])
            raise ImportFileError(
                f"has two sources for the {quantity}: '{printable(whole[0].name)}' and {others}",
                where=where,
                hint="choose with --column",
            )
        if whole:
            quantities[quantity] = _from_array(members[0][0], members[0][1], joints, array_joints, width, where, notes)
        else:
            quantities[quantity] = _from_columns(quantity, members, joints, where, notes)
    if by_unit := [role for role in roles if role.by_unit]:
        names = [f"{printable(role.name)} ({role.quantity})" for role in by_unit]
        notes.append(Note("info", f"recognised by the unit alone: {listed(names, limit=MOST_UNUSED)}"))
    if unused:
        notes.append(Note("info", f"not imported: {listed(unused, limit=MOST_UNUSED)}"))
    time, time_unit = stamps.get("time", (None, ""))
    target_time, target_time_unit = stamps.get("target_time", (None, ""))
    return ForeignTable(
        source, time, time_unit, quantities, tuple(notes), lines, target_time, target_time_unit, tuple(unused)
    )


def _origin(stamps: npt.NDArray[Any], notes: list[Note]) -> int | None:
    """The first of integer stamps that float64 can't hold (nanoseconds since 1970); None where it can."""
    if stamps.dtype.kind not in "iu" or stamps.size == 0 or int(stamps.flat[0]) <= _FLOAT_INTEGERS:
        return None
    first = int(stamps.flat[0])
    notes.append(Note("info", f"time is counted from the first sample, stamped {first}"))
    return first


def _since(stamps: npt.NDArray[Any], origin: int | None) -> npt.NDArray[Any]:
    """Integer stamps counted from another one; others as they are."""
    if origin is None or stamps.dtype.kind not in "iu" or stamps.size == 0:
        return stamps
    if int(stamps.min()) < origin:  # unsigned differences would wrap around; checked and reported later
        return stamps.astype(np.int64) - origin
    rising: npt.NDArray[Any] = stamps - stamps.dtype.type(origin)
    return rising


def _numbers(array: npt.NDArray[Any], name: str, where: str) -> FloatArray:
    if not (np.issubdtype(array.dtype, np.integer) or np.issubdtype(array.dtype, np.floating)):
        raise ImportFileError(f"holds no real numbers, but {array.dtype.name}", where=f"{where}: {printable(name)}")
    return np.asarray(array, dtype=np.float64)


def _vector(values: FloatArray, name: str, where: str) -> FloatArray:
    if values.ndim == 1 or (values.ndim == 2 and 1 in values.shape):
        return values.reshape(-1)
    raise ImportFileError(
        f"has shape {values.shape}, but one number per sample is expected: (N,)", where=f"{where}: {printable(name)}"
    )


def _from_array(
    role: Role,
    values: FloatArray,
    joints: Sequence[str],
    array_joints: tuple[str, ...] | None,
    width: int,
    where: str,
    notes: list[Note],
) -> QuantityColumns:
    place = f"{where}: {printable(role.name)}"
    if width == 1 and (values.ndim == 1 or (values.ndim == 2 and 1 in values.shape)):
        values = values.reshape(-1, 1)
    expected = f"the robot has {counted(len(joints), 'joint')}, so (N, {width}) is expected"
    if array_joints is not None:
        expected = f"the file names {width} joints, so (N, {width}) is expected"
    if values.ndim != 2 or width not in values.shape:
        one_row = "one row per sample with a column for each joint is read; a row for each joint has to be pivoted"
        raise ImportFileError(
            f"has shape {values.shape}, but {expected}",
            where=place,
            hint=one_row if values.ndim == 1 else "is it another robot's file? see --robot",
        )
    if values.shape[1] != width:
        values = values.T
        notes.append(Note("info", f"'{printable(role.name)}' was stored joints × samples and has been transposed"))
    elif values.shape[0] == width and width > 1:
        raise ImportFileError(f"has shape {values.shape}: samples and joints cannot be distinguished", where=place)
    labels = tuple(f"{role.name}[:, {column}]" for column in range(width))
    return QuantityColumns(np.ascontiguousarray(values), labels, (role.unit,) * width, array_joints, role.magnitude)


def _from_columns(
    quantity: str, members: list[tuple[Role, FloatArray]], joints: Sequence[str], where: str, notes: list[Note]
) -> QuantityColumns:
    named = [role for role, _ in members if role.joint is not None]
    numbered = [role for role, _ in members if role.number is not None]
    if named and numbered:
        raise ImportFileError(
            f"has two sources for the {quantity}: {listed(role.name for role in named)}"
            f" and {listed(role.name for role in numbered)}",
            where=where,
            hint="choose with --column",
        )
    if named:
        place = {role.joint: index for index, (role, _) in enumerate(members)}
        present = [joint for joint in joints if joint in place]
        order = [place[joint] for joint in present]
        missing = [joint for joint in joints if joint not in place]
    else:
        first = 0 if any(role.number == 0 for role in numbered) else 1
        if first == 0:
            notes.append(
                Note("info", f"columns of the {quantity} are counted from 0, as {listed(r.name for r in numbered)}")
            )
        surplus = [role.name for role in numbered if int(role.number or 0) - first >= len(joints)]
        if surplus:
            raise ImportFileError(
                f"has {counted(len(numbered), 'column')} of {quantity}, but the robot has "
                f"{counted(len(joints), 'joint')}; too many: {listed(surplus)}",
                where=where,
                hint="is it another robot's file? If not, choose the columns with --column",
            )
        by_index = {int(role.number or 0) - first: index for index, (role, _) in enumerate(members)}
        order = [by_index[joint_index] for joint_index in sorted(by_index)]
        present = [joints[joint_index] for joint_index in sorted(by_index)]
        missing = [f"{quantity} {k + first} ({joint})" for k, joint in enumerate(joints) if k not in by_index]
    if missing and quantity != "temperature":
        raise ImportFileError(
            f"has {counted(len(members), 'column')} of {quantity}, but the robot has {counted(len(joints), 'joint')};"
            f" missing: {listed(missing)}",
            where=where,
            hint="name them with --column",
        )
    if missing:
        notes.append(Note("warning", f"no {quantity} for some joints: {listed(missing)}"))
    roles = [members[index][0] for index in order]
    vectors = [_vector(members[index][1], members[index][0].name, where) for index in order]
    lengths = {role.name: len(vector) for role, vector in zip(roles, vectors, strict=True)}
    if len(set(lengths.values())) > 1:
        raise ImportFileError(
            f"columns of the {quantity} differ in length: {listed(f'{k} {v}' for k, v in lengths.items())}", where=where
        )
    return QuantityColumns(
        values=np.column_stack(vectors),
        labels=tuple(role.name for role in roles),
        units=tuple(role.unit for role in roles),
        joints=tuple(present) if named or missing else None,
        magnitude=all(role.magnitude for role in roles),
    )
