"""Reading a recording, with a clear error for each way in which it can be broken."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar

import h5py
import numpy as np

from daq.output_files import unfinished_files
from daq.recording.hdf5_bounds import Hdf5Bounds, hdf5_reason
from daq.recording.recording import SCHEMA_VERSION, Channel, Event, Recording, Stream
from drivers.core.arrays import FloatArray
from drivers.core.errors import RecordingError, UsageError
from drivers.core.files import HDF5_SIGNATURE, LONG_RECORDING_FILE, RECORDING_FILE, InputKind, check_input
from drivers.core.ranges import STAMP
from drivers.core.reading_process import read_apart
from drivers.core.terminal import hidden_character
from drivers.core.text import parsed_json
from drivers.core.units import FACTORS, conversion, normalised
from drivers.streams import UNITS

_Read = TypeVar("_Read")


def read_recording(path: str | Path, part: tuple[float, float] | None = None) -> Recording:
    """Read a recording, or a part of one that is too long for the memory.

    Args:
        path: of the file (.h5).
        part: from and until [s] after the first stamp; all of a file of up to 2 GB where None.

    Raises:
        RecordingError: no sample in the part; no such file; not HDF5; truncated; not written by dynid; newer schema;
            half-written streams; damaged so that HDF5 loops, crashes or takes too much memory over it.

    Example:
        >>> import dynid
        >>> dynid.read_recording("nowhere.h5")
        Traceback (most recent call last):
        drivers.core.errors.RecordingError: nowhere.h5: no such file
    """
    if not isinstance(path, (str, PathLike)):
        raise UsageError(f"a {type(path).__name__} is not a path of a recording", hint='dynid.read_recording("run.h5")')
    path = Path(path)
    hint = (
        f"a recording of this name was not closed: dynid recover {path}"
        if not path.exists() and unfinished_files(path)
        else ""
    )
    _check_file(path, RECORDING_FILE if part is None else LONG_RECORDING_FILE, hint)
    return read_apart(
        lambda progress: _opened(path, lambda file: read_open_recording(file, path, part)), path, RecordingError
    )


def read_stamps(path: Path) -> dict[str, FloatArray]:
    """Stream → its stamps (N,) [s] by the source's clock, however large the file.

    Raises:
        RecordingError: as `read_recording`.
    """
    return _of_clocks(path, lambda clocks: {name: np.asarray(time, dtype=np.float64) for name, time in clocks.items()})


def recording_seconds(path: Path) -> float:
    """Return how long a recording lasts [s], however large its file.

    Raises:
        RecordingError: as `read_recording`.
    """

    def longest(clocks: dict[str, Any]) -> float:
        ends = [time[[0, -1]] for time in clocks.values() if len(time) > 1]
        return max((float(last - first) for first, last in ends), default=0.0)

    return _of_clocks(path, longest)


def _of_clocks(path: Path, read: Callable[[dict[str, Any]], _Read]) -> _Read:
    """What a function makes of the stamps of each stream, which are still on the disk."""

    def of_file(file: Any) -> _Read:
        try:
            return read({name: group["time"] for name, group in file["streams"].items()})
        except (OSError, LookupError, RuntimeError, TypeError, ValueError, AttributeError) as error:
            raise RecordingError("is not a recording of dynid, or damaged", where=str(path)) from error

    _check_file(path, LONG_RECORDING_FILE)
    return read_apart(lambda progress: _opened(path, of_file), path, RecordingError)


def _check_file(path: Path, kind: InputKind, hint: str = "") -> None:
    where = str(path)
    if check_input(path, kind, RecordingError, hint) == 0:
        raise RecordingError("is empty (0 bytes)", where=where, hint="copy it again from its source")
    if not _has_hdf5_signature(path):
        raise RecordingError(
            "is not an HDF5 file",
            where=where,
            hint=f'import it: dynid import {path} --robot ROBOT -o NEW.h5, or dynid.import_recording("{path}", …)',
        )


def _opened(path: Path, read: Callable[[Any], _Read]) -> _Read:
    """Return what a function reads from the file."""
    where = str(path)
    try:
        file = h5py.File(path, "r")
    except (OSError, RuntimeError) as error:
        if "consistency flags" in str(error):
            raise RecordingError(
                "is half-written: its writer is still running, or crashed",
                where=where,
                hint=f"when no recording is running: dynid recover {path}",
            ) from error
        raise RecordingError(
            f"is truncated or still open in a writer: {hdf5_reason(error)}",
            where=where,
            hint=f"copy it again from its source; if its writer crashed: dynid recover {path}",
        ) from error
    with file:
        return read(file)


def read_open_recording(file: Any, path: Path, part: tuple[float, float] | None = None) -> Recording:
    """Read a recording, or a part, from an open HDF5 file.

    Raises:
        RecordingError: as `read_recording`, once the file is open.
    """
    try:
        return _read(file, path, part)
    except (UnicodeDecodeError, UnicodeEncodeError) as error:
        text = error.object[max(0, error.start - 20) : error.end + 20]
        said = f"holds text that is not UTF-8: {text!a}"
        raise RecordingError(said, where=str(path), hint="write its names and attributes as UTF-8") from error
    except (OSError, LookupError, RuntimeError, TypeError, ValueError, AttributeError) as error:
        # h5py raises any of these on objects of another kind or on broken structures.
        raise RecordingError(
            f"is damaged: {hdf5_reason(error)}", where=str(path), hint="copy it again from its source"
        ) from error


def _has_hdf5_signature(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return file.read(8) == HDF5_SIGNATURE
    except OSError as error:
        raise RecordingError(f"cannot be read: {error.strerror}", where=str(path)) from error


def _read(file: Any, path: Path, part: tuple[float, float] | None) -> Recording:
    where = str(path)
    attributes = file.attrs
    if "dynid_schema" not in attributes:
        raise RecordingError(
            "is an HDF5 file, but not a dynid recording (no attribute 'dynid_schema')",
            where=where,
            hint="convert it with: dynid import FILE --robot ROBOT",
        )
    schema = attributes["dynid_schema"]
    if not isinstance(schema, (int, np.integer)) or schema < 1:
        raise RecordingError(f"has the unreadable schema version {schema!r}", where=where)
    if schema > SCHEMA_VERSION:
        raise RecordingError(
            f"was written with schema version {schema}, this version of dynid reads up to {SCHEMA_VERSION}",
            where=where,
            hint="update dynid",
        )
    bounds = Hdf5Bounds(path, RecordingError)
    bounds.check_attributes(file)
    members = bounds.items(file)
    if "streams" not in members or not isinstance(members["streams"], h5py.Group) or len(members["streams"]) == 0:
        raise RecordingError("contains no stream: its writer stopped before the first one", where=where)
    for group in bounds.items(members["streams"]).values():
        for dataset in bounds.items(group).values() if isinstance(group, h5py.Group) else ():
            if isinstance(dataset, h5py.Dataset):
                bounds.check_dataset(dataset)
    within = (-math.inf, math.inf)
    if part is not None:
        clocks = [group["time"] for group in members["streams"].values()]
        begin = min((float(clock[0]) for clock in clocks if len(clock)), default=0.0)
        within = (begin + part[0], begin + part[1])
    streams = {
        name: _read_stream(group, f"{where}: /streams/{name}", within) for name, group in members["streams"].items()
    }
    if part is not None and not any(len(stream.time) for stream in streams.values()):
        raise RecordingError(f"has no sample from {part[0]:g} to {part[1]:g} s", where=where)
    return Recording(
        path=path,
        part=part,
        robot_text=_text(file, "robot"),
        urdf_text=_text(file, "urdf"),
        created=_text(file, "created"),
        versions=_read_versions(_text(file, "versions")),
        trajectory=_text(file, "trajectory"),
        speed_scale=_read_speed_scale(attributes.get("speed_scale", 1.0)),
        host=_text(file, "host"),
        comment=_text(file, "comment"),
        complete=bool(attributes.get("complete", False)),
        streams=streams,
        events=tuple(
            event
            for event in read_events(members.get("events"), bounds)
            if part is None or math.isnan(event.time) or within[0] <= event.time < within[1]
        ),
    )


def _text(owner: Any, name: str) -> str:
    """An attribute of a file, a group or a dataset; empty where there is none. UnicodeError where it is not UTF-8."""
    value = owner.attrs.get(name, "")
    return value.decode() if isinstance(value, bytes) else str(value).encode().decode()


def _read_speed_scale(value: Any) -> float:
    """A number above 0 and at most 1; 1 for anything else, as in files from before there was one."""
    try:
        scale = float(value)
    except (TypeError, ValueError):
        return 1.0
    return scale if 0.0 < scale <= 1.0 else 1.0


def _read_versions(text: str) -> dict[str, str]:
    try:
        versions = parsed_json(text)
    except ValueError:
        return {}
    return {str(key): str(value) for key, value in versions.items()} if isinstance(versions, dict) else {}


def _read_stream(group: Any, where: str, within: tuple[float, float]) -> Stream:  # noqa: C901, PLR0912 — a branch per mistake
    if not isinstance(group, h5py.Group) or "time" not in group:
        raise RecordingError("has no dataset 'time'", where=where)
    for name, dataset in group.items():
        if not isinstance(dataset, h5py.Dataset) or not dataset.shape:
            raise RecordingError(f"'{name}' is not a dataset with one row per sample", where=where)
    lengths = {name: dataset.shape[0] for name, dataset in group.items()}
    count = lengths["time"]
    if any(length != count for length in lengths.values()):
        # A crash between two appends leaves columns of different length; the common rows are valid.
        if min(lengths.values()) == 0:
            raise RecordingError(f"is half-written: rows per dataset {lengths}", where=where)
        count = min(lengths.values())
    for clock in ("time", "host_time"):
        if clock in group and group[clock].ndim != 1:
            raise RecordingError(f"'{clock}' has shape {group[clock].shape}; (N,) expected", where=where)
    rows = slice(0, count)
    if math.isfinite(within[0]):  # a search in the file: the stamps of a week take a gigabyte
        rows = slice(*(bisect_left(group["time"], border, 0, count) for border in within))
    time = _read_clock(group, "time", rows, where)
    host_time = _read_clock(group, "host_time", rows, where) if "host_time" in group else time
    channels = {}
    for name, dataset in group.items():
        if name in ("time", "host_time"):
            continue
        if dataset.ndim != 2 or dataset.dtype.kind not in "iuf":
            raise RecordingError(
                f"'{name}' has shape {dataset.shape}, type {dataset.dtype}; (N, n) numbers expected", where=where
            )
        columns = tuple(str(column) for column in dataset.attrs.get("joints", ()))
        for text in (group.name, name, *columns):
            if hidden := hidden_character(text):
                raise RecordingError(f"the name '{text}' holds the character {hidden}", where=where)
        if len(columns) != dataset.shape[1]:
            raise RecordingError(
                f"'{name}' has {dataset.shape[1]} columns, but its attribute 'joints' names {len(columns)}", where=where
            )
        if len(set(columns)) < len(columns):
            raise RecordingError(f"'{name}' names a column twice: {', '.join(columns)}", where=where)
        channels[name] = Channel(
            quantity=name,
            values=np.asarray(dataset[rows], dtype=np.float64),
            unit=_unit(dataset, where),
            columns=columns,
            description=_text(dataset, "description"),
            magnitude=bool(dataset.attrs.get("magnitude", False)),
        )
    return Stream(name=group.name.rsplit("/", 1)[-1], time=time, host_time=host_time, channels=channels)


def _unit(dataset: Any, where: str) -> str:
    unit, quantity = _text(dataset, "unit"), dataset.name.rsplit("/", 1)[-1]
    known = normalised(unit)
    if quantity in UNITS and known in FACTORS and conversion(known) != (1.0, 0.0):
        raise RecordingError(
            f"'{quantity}' is in {unit}; values of a recording are in SI units",
            where=where,
            hint="convert them, and state the unit they are in then as the attribute 'unit'",
        )
    return unit


def _read_clock(group: Any, name: str, rows: slice, where: str) -> FloatArray:
    stamps = np.asarray(group[name][rows], dtype=np.float64)
    absurd = np.flatnonzero(np.abs(stamps) > STAMP.most)
    if len(absurd):
        raise RecordingError(
            f"the '{name}' of sample {rows.start + absurd[0]}, {stamps[absurd[0]]:g} s, is not within {STAMP}",
            where=where,
        )
    return stamps


def read_events(table: Any, bounds: Hdf5Bounds) -> tuple[Event, ...]:
    """The events of a file's table; none where it is None."""
    if table is None:
        return ()
    bounds.check_dataset(table)

    def text(value: Any) -> str:
        return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)

    return tuple(
        Event(float(row["time"]), text(row["level"]), text(row["source"]), text(row["message"]))  # type: ignore[arg-type]
        for row in bounds.rows(table)
    )
