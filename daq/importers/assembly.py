"""Assemble a table's columns into SI quantities in the robot's joint order, stamped in seconds from one moment."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from daq.importers.choices import ImportChoices
from daq.importers.matching import match_joints, with_own_names
from daq.importers.naming import allowed_units, to_si
from daq.importers.table import ForeignTable, Note, QuantityColumns, listed, printable
from daq.recording.recording import MOTOR_SIGNALS, Level
from daq.robot.loader import RobotFile
from daq.robot.schema import Robot
from drivers.core.arrays import FloatArray
from drivers.core.errors import ImportFileError
from drivers.core.text import counted
from drivers.core.units import normalised
from drivers.streams import COMMANDS

EPOCH = 1e8
"""[s]; stamps beyond it count from 1970, not from the start of a measurement (it is March 1973)."""


@dataclass(frozen=True)
class Quantity:
    """One quantity in SI: `values` (N, n), a column for each of `joints`, with the file's `labels`.

    `magnitude` says whether the values have lost their sign.
    """

    values: FloatArray
    joints: tuple[str, ...]
    labels: tuple[str, ...]
    magnitude: bool = False


@dataclass(frozen=True)
class ImportedSamples:
    """A file's content in SI and in the robot's order; `time` (N,) [s]; `notes` to be recorded as events.

    Every array has N rows; `lines` (N,) are line numbers of a text file or None. `commands` are those with stamps of
    their own.
    """

    time: FloatArray
    quantities: dict[str, Quantity]
    notes: tuple[Note, ...]
    lines: tuple[int, ...] | None
    commands: ImportedSamples | None = None


def _numbered(names: Sequence[str], count: int) -> str:
    """The pattern of `count` numbered names: `joint{}` of joint1 to joint6; empty where none has so many."""
    plain = [name for name in names if re.fullmatch(r"\D*\d+\D*", name) and re.fullmatch(r"[\w./-]+", name)]
    patterns = [re.sub(r"\d+", "{}", name) for name in plain]
    return next((pattern for pattern in patterns if patterns.count(pattern) == count), "")


def assemble(table: ForeignTable, robot: RobotFile, choices: ImportChoices, where: str) -> ImportedSamples:
    """Match the joints, decide what effort is, convert units, determine the time.

    Raises:
        ImportFileError: joints that do not match, an undecided effort, unknown or mixed units, no time, arrays of
            different length.
    """
    notes = list(table.notes)
    foreign = _decide_effort(dict(table.quantities), choices, where)
    if "position" not in foreign:
        others = f"; not recognised: {listed(table.unused, limit=20)}" if table.unused else ""
        pattern = _numbered(table.unused, len(robot.robot.joints))
        raise ImportFileError(
            f"has no joint positions; recognised: {listed(foreign) or 'none'}{others}",
            where=where,
            hint=f"--column q={pattern} if these are the positions"
            if pattern
            else "map them: --column q1=NAME (or q=NAME for a whole array)",
        )
    apart = _commands_apart(table, foreign, where)
    measured = {name: given for name, given in foreign.items() if name not in apart}
    _check_lengths({"time": table.time}, measured, where)
    _check_lengths({"target_time": table.target_time}, apart, where)
    names = robot.robot.joint_names
    quantities = {}
    unnamed = sorted(quantity for quantity, given in foreign.items() if given.joints is None)
    if unnamed:
        order = ", ".join(names)
        notes.append(Note("info", f"joints matched by order (the file has no names) for {listed(unnamed)}: {order}"))
    for quantity, given in foreign.items():
        ordered, match_notes = _in_robot_order(quantity, given, robot.robot, choices, where)
        notes.extend(note for note in match_notes if note not in notes)
        in_si = _in_si(quantity, ordered, robot, choices, where, notes)
        quantities[quantity] = replace(in_si, magnitude=_is_magnitude(quantity, given, in_si, robot.robot, notes))
    if "torque" not in quantities and "current" not in quantities:
        commanded = "target_position" in quantities
        use = "it is good for a servo model" if commanded else "nothing can be identified from it"
        beside = "" if commanded else ", nor commanded positions"
        level: Level = "info" if commanded else "warning"
        notes.append(Note(level, f"neither torque nor current{beside} in the file: {use}"))
    time, target_time = sample_times(table, len(quantities["position"].values), choices, where, notes)
    lines = tuple(int(line) for line in table.lines) if table.lines is not None else None
    samples = ImportedSamples(time, quantities, (), lines)
    if apart:
        assert target_time is not None
        commands = ImportedSamples(target_time, {name: quantities.pop(name) for name in apart}, (), lines)
        samples = replace(_without_padding(samples), commands=_without_padding(commands))
    return replace(samples, notes=tuple(notes))


def _commands_apart(
    table: ForeignTable, quantities: dict[str, QuantityColumns], where: str
) -> dict[str, QuantityColumns]:
    """The commands whose stamps are not those of the samples."""
    commands = {name: given for name, given in quantities.items() if name in COMMANDS}
    if table.target_time is None:
        count = len(quantities["position"].values)
        for name, given in commands.items():
            if len(given.values) != count:
                raise ImportFileError(
                    f"has {counted(len(given.values), 'sample')} of {name} without stamps, and {count} of the position",
                    where=where,
                    hint="name their time column: --column target_time=NAME",
                )
        return {}
    same = (
        table.time is not None
        and np.array_equal(table.target_time, table.time)
        and table.target_time_unit == table.time_unit
    )
    return {} if same else commands


def _decide_effort(
    quantities: dict[str, QuantityColumns], choices: ImportChoices, where: str
) -> dict[str, QuantityColumns]:
    effort = quantities.pop("effort", None)
    if effort is None:
        if choices.effort is not None and choices.effort not in quantities:
            raise ImportFileError(
                f"has neither effort nor {choices.effort}; recognised: {listed(quantities) or 'none'}",
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


def _count_in_amperes(values: FloatArray, robot: Robot, notes: list[Note]) -> None:
    """Convert currents (N, n) that are counts of the drives, which whole numbers without a unit are."""
    counts = [robot.drive(name).count for name in robot.joint_names]
    if None in counts or not np.array_equal(values, np.round(values)):
        return
    values *= np.array(counts, dtype=np.float64)
    sizes = ", ".join(f"{1e3 * count:g} mA" for count in dict.fromkeys(counts) if count is not None)
    notes.append(Note("info", f"current converted from counts of {sizes} (the robot file's drives)"))


def _without_padding(samples: ImportedSamples) -> ImportedSamples:
    """The samples up to the last row that holds a number: a text file pads the shorter of two streams."""
    filled = np.isfinite(samples.time)
    for entry in samples.quantities.values():
        filled |= np.isfinite(entry.values).any(axis=1)
    count = int(np.flatnonzero(filled)[-1]) + 1 if filled.any() else 0
    return rows(samples, np.arange(count)) if 2 <= count < len(filled) else samples


def _is_magnitude(quantity: str, given: QuantityColumns, in_si: Quantity, robot: Robot, notes: list[Note]) -> bool:
    """Return whether the values of a motor signal have lost their sign, as the file's names or the robot file say."""
    unsigned = [name for name in in_si.joints if robot.drive(name).signal == "magnitude"]
    if quantity not in MOTOR_SIGNALS or not (given.magnitude or unsigned):
        return False
    if np.any(in_si.values < 0):
        says = "its name" if given.magnitude else "the robot file (signal: magnitude)"
        notes.append(Note("warning", f"{quantity} has negative values, so it is not a magnitude as {says} says"))
        return False
    notes.append(Note("info", f"{quantity} is a magnitude: its sign is lost"))
    return True


def _check_lengths(stamps: dict[str, FloatArray | None], quantities: dict[str, QuantityColumns], where: str) -> None:
    if not quantities:
        return
    lengths = {name: len(time) for name, time in stamps.items() if time is not None}
    lengths |= {quantity: len(given.values) for quantity, given in quantities.items()}
    if len(set(lengths.values())) > 1:
        raise ImportFileError(
            f"arrays differ in length: {', '.join(f'{name} {length}' for name, length in lengths.items())}", where=where
        )
    if min(lengths.values()) < 2:
        raise ImportFileError(f"holds {counted(min(lengths.values()), 'sample')}; at least 2 are needed", where=where)


def _in_robot_order(
    quantity: str, given: QuantityColumns, robot: Robot, choices: ImportChoices, where: str
) -> tuple[QuantityColumns, tuple[Note, ...]]:
    names = robot.joint_names
    if given.joints is None:
        return replace(given, joints=names), ()
    if quantity == "temperature" and set(given.joints) <= set(names):
        return given, ()
    called, notes = with_own_names(given.joints, robot)
    match = match_joints(called, names, by_order=choices.by_order, where=f"{where}: {quantity}")
    columns = list(match.columns)
    ordered = replace(
        given,
        values=given.values[:, columns],
        labels=tuple(given.labels[column] for column in columns),
        units=tuple(given.units[column] for column in columns),
        joints=names,
    )
    return ordered, (*notes, *match.notes)


def _in_si(
    quantity: str, given: QuantityColumns, robot: RobotFile, choices: ImportChoices, where: str, notes: list[Note]
) -> Quantity:
    sliding = robot.prismatic_joints
    joints = given.joints or ()
    stated = [label for label, unit in zip(given.labels, given.units, strict=True) if unit]
    silent = [label for label, unit in zip(given.labels, given.units, strict=True) if not unit]
    if stated and silent:
        raise ImportFileError(
            f"mixed units of {quantity}: {listed(stated)} state one, {listed(silent)} do not",
            where=where,
            hint="state the unit of all or of none",
        )
    kind = quantity.removeprefix("target_")
    angular = kind in ("position", "velocity")
    values = given.values.copy()
    used: dict[str, list[str]] = {}
    for column, (label, unit, joint) in enumerate(zip(given.labels, given.units, joints, strict=True)):
        prismatic = joint in sliding
        if angular and choices.degrees and not prismatic:
            degrees = "deg" if kind == "position" else "deg/s"
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
                f"unit '{printable(unit)}' is not one of {quantity}: {allowed_units(quantity, prismatic=prismatic)}",
                where=f"{where}: {printable(label)}",
            )
        factor, offset = conversion
        if factor != 1.0 or offset != 0.0:
            values[:, column] = factor * values[:, column] + offset
            used.setdefault(unit, []).append(joint)
    if quantity == "current" and not stated:
        _count_in_amperes(values, robot.robot, notes)
    for unit, converted in used.items():
        whose = "all joints" if len(converted) == len(joints) else listed(converted)
        notes.append(Note("info", f"{quantity} converted from {printable(unit)}: {whose}"))
    left = [joint for joint in joints if joint in sliding]
    if angular and choices.degrees and left:
        notes.append(Note("info", f"{quantity} of prismatic joints not converted from degrees: {listed(left)}"))
    return Quantity(values, joints, given.labels)


def rows(samples: ImportedSamples, index: npt.NDArray[np.intp]) -> ImportedSamples:
    """The samples at the given indices, in their order."""
    quantities = {name: replace(entry, values=entry.values[index]) for name, entry in samples.quantities.items()}
    lines = tuple(samples.lines[k] for k in index) if samples.lines is not None else None
    return replace(samples, time=samples.time[index], quantities=quantities, lines=lines)


def sample_times(
    table: ForeignTable, count: int, choices: ImportChoices, where: str, notes: list[Note]
) -> tuple[FloatArray, FloatArray | None]:
    """Stamps of the samples (N,) and, where they have their own, of the commands (M,) [s].

    Assumptions are appended to `notes`; `count` is N.

    Raises:
        ImportFileError: no stamps and no rate, both, or an unknown unit.
    """
    if table.time is None:
        if choices.rate is None:
            raise ImportFileError(
                "has no time", where=where, hint="give the sampling rate: --rate HZ, or map a column: --column t=NAME"
            )
        notes.append(Note("info", f"the file has no time; uniform stamps at {choices.rate:g} Hz were assumed"))
        time, factor, origin = np.arange(count) / choices.rate, 1.0, 0.0
    else:
        if choices.rate is not None:
            raise ImportFileError(
                f"has time stamps; --rate {choices.rate:g} would discard them", where=where, hint="leave --rate out"
            )
        factor = _factor(table.time_unit, choices, where, notes)
        finite = table.time[np.isfinite(table.time)]
        origin = float(finite.min()) if len(finite) else 0.0
        if origin * factor > EPOCH:
            text = f"time is counted from the first sample, stamped {origin * factor:.6f} s after 1970"
            notes.append(Note("info", text))
        else:
            origin = 0.0
        # Subtracted before the conversion, where integer stamps are still exact.
        time = (table.time - origin) * factor
    if table.target_time is None:
        return time, None
    own = _factor(table.target_time_unit or table.time_unit, choices, where, notes)
    origin = origin if own == factor else origin * factor / own
    return time, (table.target_time - origin) * own


def _factor(stated: str, choices: ImportChoices, where: str, notes: list[Note]) -> float:
    """Seconds of the unit that the file states or the user gives."""
    if choices.time_unit is not None and stated and normalised(stated) != choices.time_unit:
        raise ImportFileError(
            f"states the time in {printable(stated)}, but --time-unit {choices.time_unit} was given",
            where=where,
            hint="leave --time-unit out",
        )
    unit = choices.time_unit or stated or "s"
    conversion = to_si("time", unit, prismatic=False)
    if conversion is None:
        allowed = allowed_units("time", prismatic=False)
        raise ImportFileError(f"unit '{printable(unit)}' is none of time: {allowed}", where=where)
    note = Note("info", f"time converted from {printable(unit)}")
    if conversion[0] != 1.0 and note not in notes:
        notes.append(note)
    return conversion[0]
