"""Data frames and named arrays in memory as recordings: matched, converted and checked as the columns of a file are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from daq.importers.choices import ImportChoices
from daq.importers.collecting import collect
from daq.importers.import_file import recording_of_table
from daq.importers.naming import Role, parse_name
from daq.importers.roles import assign_roles
from daq.importers.table import listed, printable
from daq.recording.recording import DictOptions, FrameOptions, Recording
from daq.robot.loader import load_robot
from drivers.core.errors import ImportFileError, UsageError
from drivers.core.options import same_named

TIME = "t"
NANOSECONDS = "ns"


@dataclass(frozen=True)
class NamedArrays:
    """Arrays by their names, and the units that are stated beside them."""

    source: str
    where: str
    arrays: Mapping[str, npt.NDArray[Any]]
    units: Mapping[str, str]


def arrays_of_frame(frame: Any) -> NamedArrays:
    """The columns of a pandas or polars data frame; the index where it holds times and no column does.

    Raises:
        UsageError: it is not a data frame.
        ImportFileError: two columns have one name, or a column holds no numbers.
    """
    where = "Recording.from_dataframe"
    if not hasattr(frame, "columns") or not hasattr(frame, "shape"):
        raise UsageError(f"a {type(frame).__name__} is not a data frame", where=where, hint=_other_door(frame))
    names = [_name(column) for column in frame.columns]
    if all(isinstance(column, (int, np.integer)) for column in frame.columns):  # unnamed
        names = [f"column {place}" for place in range(1, len(names) + 1)]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ImportFileError(f"has several columns called {listed(twice)}", where=where, hint="rename them")
    units: dict[str, str] = dict(getattr(frame, "attrs", {}).get("units", {}))
    arrays = {}
    for name, column in zip(names, frame.columns, strict=True):
        arrays[name] = _array(name, frame[column], where, units)
    index = getattr(frame, "index", None)
    if index is not None and not any(_is_time(name) for name in names):
        name = str(index.name) if _is_time(str(index.name)) else TIME
        if name != TIME or (type(index).__name__ != "RangeIndex" and index.dtype.kind in "iufmM"):
            arrays = {name: _array(name, index, where, units), **arrays}
    return NamedArrays("data frame", where, arrays, units)


def arrays_of_dict(given: Mapping[str, npt.ArrayLike]) -> NamedArrays:
    """The arrays of a dictionary.

    Raises:
        UsageError: it is not a dictionary.
        ImportFileError: an array does not consist of numbers.
    """
    where = "Recording.from_dict"
    if not isinstance(given, Mapping):
        raise UsageError(f"a {type(given).__name__} is not a dictionary", where=where, hint=_other_door(given))
    units: dict[str, str] = {}
    return NamedArrays(
        "dictionary", where, {_name(name): _array(_name(name), of, where, units) for name, of in given.items()}, units
    )


def recording_of_arrays(given: NamedArrays, options: FrameOptions | DictOptions) -> Recording:
    """A recording of named arrays.

    Raises:
        ImportFileError: names that are not understood, or arrays that are wrong, incomplete or ambiguous.
        UsageError: options that do not apply.
    """
    robot = load_robot(options.robot)
    joints, where = robot.robot.joint_names, given.where
    roles = assign_roles(list(given.arrays), joints, options.columns, where, numbered=True)
    if not roles:
        numbers = f'"2-{1 + len(joints)}"'
        raise ImportFileError(
            f"has no column with a recognised name; it has: {listed(given.arrays) or 'none'}",
            where=where,
            hint=f'name them t, q1, q2, …, torque1, …, or number them: columns={{"t": "1", "q": {numbers}, …}}',
        )
    units = {**given.units, **options.units}
    for key in options.units:
        if key not in given.arrays and parse_name(key, joints) is None:
            raise UsageError(
                f"units names '{printable(key)}', which is neither a column nor a quantity",
                where=where,
                hint='such as units={"position": "deg", "torque": "Nm"}',
            )
    stated = {role.name: unit for role in roles if (unit := _unit(role, units, joints))}
    roles = tuple(replace(role, unit="") if role.name in stated else role for role in roles)
    names = {role.name for role in roles}
    table = collect(
        given.source,
        roles,
        {name: array for name, array in given.arrays.items() if name in names},
        joints,
        where,
        units=stated,
        unused=[name for name in given.arrays if name not in names],
    )
    return recording_of_table(
        table, robot, same_named(options, ImportChoices), where, options.comment or f"from a {given.source}"
    )


def _unit(role: Role, units: Mapping[str, str], joints: Sequence[str]) -> str:
    """The unit that is stated for a column, or for its quantity."""
    if role.name in units:
        return str(units[role.name])
    for key, unit in units.items():
        meant = parse_name(key, joints)
        if meant is not None and meant.quantity == role.quantity and meant.number is None and meant.joint is None:
            return str(unit)
    return ""


def _is_time(name: str) -> bool:
    role = parse_name(name, ())
    return role is not None and role.quantity == "time"


def _name(column: object) -> str:
    """A column's name as text; levels of several, as in `("position", "elbow")`, are joined."""
    return "_".join(map(str, column)) if isinstance(column, tuple) else str(column)


def _array(name: str, values: Any, where: str, units: dict[str, str]) -> npt.NDArray[Any]:
    """Numbers; dates and durations as nanoseconds, whose unit is entered."""
    try:
        array = np.asarray(values)
        if array.dtype == object and hasattr(values, "to_numpy"):  # numbers with gaps
            array = values.to_numpy(dtype=np.float64, na_value=np.nan)
    except (TypeError, ValueError, RuntimeError) as error:  # rows of several lengths; a tensor with a gradient
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise ImportFileError(
            f"does not consist of numbers in equal rows: {printable(reason)}",
            where=f"{where}: {printable(name)}",
            hint="pandas.read_csv reads decimal commas with decimal=',', and skips a line of units with skiprows=[1]"
            if "string" in reason
            else "",
        ) from error
    if array.dtype.kind in "mM":
        units[name] = NANOSECONDS
        return array.astype(f"{array.dtype.kind}8[{NANOSECONDS}]").astype(np.int64)
    return array


def _other_door(given: object) -> str:
    if hasattr(given, "columns"):
        return "Recording.from_dataframe takes it"
    if isinstance(given, Mapping):
        return "Recording.from_dict takes it"
    if isinstance(given, str):
        return "the robot comes first, then the numbers; dynid.import_recording reads files"
    return "Recording.from_arrays takes arrays: time=, position=, torque= or current="
