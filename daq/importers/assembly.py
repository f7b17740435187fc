"""From a table to SI quantities in the robot's joint order."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from daq.importers.choices import ImportChoices
from daq.importers.matching import match_joints
from daq.importers.table import ForeignTable, Note, QuantityColumns, listed, printable
from daq.importers.units import allowed_units, to_si
from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from drivers.core.errors import ImportFileError
from drivers.core.units import normalised

EPOCH = 1e8
"""[s]; stamps beyond it count from 1970, not from the start of a measurement (it is March 1973)."""


@dataclass(frozen=True)
class Quantity:
    """One quantity in SI: `values` (N, n), a column for each of `joints`, with the file's `labels`."""

    values: FloatArray
    joints: tuple[str, ...]
    labels: tuple[str, ...]


@dataclass(frozen=True)
class ImportedSamples:
    """A file's content in SI and in the robot's order; `time` (N,) [s]; `notes` to be recorded as events.

    Every array has N rows; `lines` (N,) are line numbers of a text file or None.
    """

    time: FloatArray
    quantities: dict[str, Quantity]
    notes: tuple[Note, ...]
    lines: tuple[int, ...] | None


def assemble(table: ForeignTable, robot: RobotFile, choices: ImportChoices, where: str) -> ImportedSamples:
    """Match the joints, decide what effort is, convert units, determine the time.

    Args:
        table: as a reader gave it.
        robot: whose joints are meant.
        choices: the user's.
        where: the file, for messages.

    Raises:
        ImportFileError: joints that do not match, an undecided effort, unknown or mixed units, no time, arrays of
            different length.
    """
    notes = list(table.notes)
    foreign = _decide_effort(dict(table.quantities), choices, where)
    if "position" not in foreign:
        raise ImportFileError(
            f"has no joint positions; understood were: {listed(foreign) or 'none'}",
            where=where,
            hint="map them: --column q1=NAME (or q=NAME for a whole array)",
        )
    sliding = robot.prismatic_joints
    _check_lengths(table, foreign, where)
    names = robot.robot.joint_names
    quantities = {}
    unnamed = sorted(quantity for quantity, given in foreign.items() if given.joints is None)
    if unnamed:
        order = ", ".join(names)
        notes.append(Note("info", f"joints matched by order (the file has no names) for {listed(unnamed)}: {order}"))
    for quantity, given in foreign.items():
        ordered, match_notes = _in_robot_order(quantity, given, names, choices, where)
        notes.extend(note for note in match_notes if note not in notes)
        quantities[quantity] = _in_si(quantity, ordered, sliding, choices, where, notes)
    if "torque" not in quantities and "current" not in quantities:
        notes.append(Note("warning", "neither torque nor current in the file; nothing can be identified from it"))
    count = len(quantities["position"].values)
    time = _time(table, count, choices, where, notes)
    lines = tuple(int(line) for line in table.lines) if table.lines is not None else None
    return ImportedSamples(time, quantities, tuple(notes), lines)


def _decide_effort(
    quantities: dict[str, QuantityColumns], choices: ImportChoices, where: str
) -> dict[str, QuantityColumns]:
    effort = quantities.pop("effort", None)
    if effort is None:
        if choices.effort is not None and choices.effort not in quantities:
            raise ImportFileError(
                f"has neither effort nor {choices.effort}; understood were: {listed(quantities) or 'none'}",
                where=where,
                hint=f"leave --effort {choices.effort} out, or map the columns with --column",
            )
        return quantities
    if choices.effort is None:
        raise ImportFileError(
            "has 'effort', which is a motor current with some drivers and a joint torque with others",
            where=where,
            hint="say which: --effort torque or --effort current",
        )
    if choices.effort in quantities:
        raise ImportFileError(
            f"has both effort and {choices.effort}", where=where, hint="choose one with --column and leave --effort out"
        )
    return {**quantities, choices.effort: effort}


def _check_lengths(table: ForeignTable, quantities: dict[str, QuantityColumns], where: str) -> None:
    lengths = {quantity: len(given.values) for quantity, given in quantities.items()}
    if table.time is not None:
        lengths = {"time": len(table.time), **lengths}
    if len(set(lengths.values())) > 1:
        raise ImportFileError(
            f"arrays differ in length: {', '.join(f'{name} {length}' for name, length in lengths.items())}", where=where
        )
    if min(lengths.values()) < 2:
        raise ImportFileError(f"holds {min(lengths.values())} sample(s); at least 2 are needed", where=where)


def _in_robot_order(
    quantity: str, given: QuantityColumns, names: tuple[str, ...], choices: ImportChoices, where: str
) -> tuple[QuantityColumns, tuple[Note, ...]]:
    if given.joints is None:
        return replace(given, joints=names), ()
    if quantity == "temperature" and set(given.joints) <= set(names):
        return given, ()
    match = match_joints(given.joints, names, by_order=choices.by_order, where=f"{where}: {quantity}")
    columns = list(match.columns)
    ordered = QuantityColumns(
        given.values[:, columns],
        tuple(given.labels[column] for column in columns),
        tuple(given.units[column] for column in columns),
        names,
    )
    return ordered, match.notes


def _in_si(
    quantity: str,
    given: QuantityColumns,
    sliding: frozenset[str],
    choices: ImportChoices,
    where: str,
    notes: list[Note],
) -> Quantity:
    joints = given.joints or ()
    stated = [label for label, unit in zip(given.labels, given.units, strict=True) if unit]
    silent = [label for label, unit in zip(given.labels, given.units, strict=True) if not unit]
    if stated and silent:
        raise ImportFileError(
            f"mixed units of {quantity}: {listed(stated)} state one, {listed(silent)} don't",
            where=where,
            hint="state the unit of all of them or of none",
        )
    angular = quantity in ("position", "velocity")
    values = given.values.copy()
    used: dict[str, list[str]] = {}
    for column, (label, unit, joint) in enumerate(zip(given.labels, given.units, joints, strict=True)):
        prismatic = joint in sliding
        if angular and choices.degrees and not prismatic:
            degrees = "deg" if quantity == "position" else "deg/s"
            if unit and not normalised(unit).startswith("deg"):
                raise ImportFileError(
                    f"states the unit {printable(unit)}, but --degrees was given",
                    where=f"{where}: {printable(label)}",
                    hint="leave --degrees out",
                )
            unit = unit or degrees
        if not unit:
            continue
        conversion = to_si(quantity, unit, prismatic=prismatic)
        if conversion is None:
            raise ImportFileError(
                f"unit '{printable(unit)}' is none of {quantity}: {allowed_units(quantity, prismatic=prismatic)}",
                where=f"{where}: {printable(label)}",
            )
        factor, offset = conversion
        if factor != 1.0 or offset != 0.0:
            values[:, column] = factor * values[:, column] + offset
            used.setdefault(unit, []).append(joint)
    for unit, converted in used.items():
        whose = "all joints" if len(converted) == len(joints) else listed(converted)
        notes.append(Note("info", f"{quantity} converted from {printable(unit)}: {whose}"))
    left = [joint for joint in joints if joint in sliding]
    if angular and choices.degrees and left:
        notes.append(Note("info", f"{quantity} of prismatic joints not converted from degrees: {listed(left)}"))
    return Quantity(values, joints, given.labels)


def _time(table: ForeignTable, count: int, choices: ImportChoices, where: str, notes: list[Note]) -> FloatArray:
    if table.time is None:
        if choices.rate is None:
            raise ImportFileError(
                "has no time", where=where, hint="give the sampling rate: --rate HZ, or map a column: --column t=NAME"
            )
        notes.append(Note("info", f"the file has no time; uniform stamps at {choices.rate:g} Hz were assumed"))
        return np.arange(count) / choices.rate
    if choices.rate is not None:
        raise ImportFileError(
            f"has time stamps; --rate {choices.rate:g} would throw them away", where=where, hint="leave --rate out"
        )
    if choices.time_unit is not None and table.time_unit and normalised(table.time_unit) != choices.time_unit:
        raise ImportFileError(
            f"states the time in {printable(table.time_unit)}, but --time-unit {choices.time_unit} was given",
            where=where,
            hint="leave --time-unit out",
        )
    unit = choices.time_unit or table.time_unit or "s"
    conversion = to_si("time", unit, prismatic=False)
    if conversion is None:
        allowed = allowed_units("time", prismatic=False)
        raise ImportFileError(f"unit '{printable(unit)}' is none of time: {allowed}", where=where)
    factor = conversion[0]
    time = table.time
    if factor != 1.0:
        notes.append(Note("info", f"time converted from {printable(unit)}"))
    finite = time[np.isfinite(time)]
    start = float(finite.min()) if len(finite) else 0.0
    if start * factor > EPOCH:
        # Subtracted before the conversion, where integer stamps are still exact.
        time = time - start
        notes.append(Note("info", f"time is counted from the first sample, stamped {start * factor:.6f} s after 1970"))
    converted: FloatArray = time * factor
    return converted


def rows(samples: ImportedSamples, index: npt.NDArray[np.intp]) -> ImportedSamples:
    """The samples at the given indices, in their order."""
    quantities = {name: replace(entry, values=entry.values[index]) for name, entry in samples.quantities.items()}
    lines = tuple(samples.lines[k] for k in index) if samples.lines is not None else None
    return ImportedSamples(samples.time[index], quantities, samples.notes, lines)
