"""The recording: HDF5 schema version 1 (DESIGN.md "The recording").

    /            attrs: dynid_schema, robot, urdf, created, versions, trajectory, host, comment, complete
    /streams/<name>/time, host_time      (N,) float64 [s]
    /streams/<name>/<quantity>           (N, n), attrs unit, description, joints
    /events      compound (N,): time, level, source, message

Everything is created before the first append and nothing is resized but along N, as HDF5's single-writer
multiple-reader mode demands; a writer only appends and flips `complete` at the end.
"""

from __future__ import annotations

import json
import platform
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import h5py
import numpy as np
import numpy.typing as npt

from daq.robot import RobotFile, parse_robot
from drivers.errors import RecordingError, RobotFileError

SCHEMA_VERSION = 1
JOINTS_STREAM = "joints"
CHUNK_SECONDS = 1.0
MAX_CHUNK_ROWS = 20_000  # a nominal rate that came out of nearly equal stamps must not size a chunk
EVENT_CHUNK_ROWS = 64

Level = Literal["info", "warning", "error"]
FloatArray = npt.NDArray[np.float64]

UNITS: Mapping[str, str] = {
    "position": "rad",
    "velocity": "rad/s",
    "acceleration": "rad/s^2",
    "current": "A",
    "voltage": "V",
    "torque": "N*m",
    "temperature": "degC",
    "target_position": "rad",
    "target_velocity": "rad/s",
    "target_current": "A",
    "target_torque": "N*m",
}
"""Unit of each quantity that dynid knows; another quantity brings its own."""


@dataclass(frozen=True)
class ChannelLayout:
    """What one dataset of a stream holds.

    Attributes:
        quantity: name of the dataset (`position`, `current`, …).
        columns: names of its n columns; joint names wherever it has one a joint.
        unit: unit of every value; taken from `UNITS` where empty.
        description: where the values come from, in words.
    """

    quantity: str
    columns: tuple[str, ...]
    unit: str = ""
    description: str = ""

    def __post_init__(self) -> None:
        if not self.unit:
            if self.quantity not in UNITS:
                raise ValueError(f"quantity '{self.quantity}' needs a unit")
            object.__setattr__(self, "unit", UNITS[self.quantity])


@dataclass(frozen=True)
class StreamLayout:
    """A stream before its first sample.

    Attributes:
        name: of the group under /streams.
        channels: its datasets.
        rate: nominal rate [Hz], sets the chunk length; 0 where unknown.
    """

    name: str
    channels: tuple[ChannelLayout, ...]
    rate: float = 0.0


@dataclass(frozen=True)
class Channel:
    """One dataset of a stream: `values` (N, n) in `unit`, a column for each name in `columns`."""

    quantity: str
    values: FloatArray
    unit: str
    columns: tuple[str, ...]
    description: str = ""


@dataclass(frozen=True)
class Stream:
    """Samples of one source.

    Attributes:
        name: of the stream.
        time: (N,) the source's own clock [s].
        host_time: (N,) the host's monotonic clock [s]; equal to `time` where the source was imported.
        channels: quantity → channel.
    """

    name: str
    time: FloatArray
    host_time: FloatArray
    channels: Mapping[str, Channel]


@dataclass(frozen=True)
class Event:
    """Something that happened: a gap, a limit hit, a repair, the reason of a stop; `time` in the source's clock [s]."""

    time: float
    level: Level
    source: str
    message: str


@dataclass(frozen=True)
class Recording:
    """A recording as it was read.

    Attributes:
        path: file it came from; None for one that was built in memory.
        robot_text: the whole robot file.
        urdf_text: the URDF that the robot file names; empty where it names none.
        complete: whether the writer closed it in order.
        streams: name → stream.
        events: in order of writing.
        created: ISO 8601, UTC.
        versions: package → version at the time of writing.
        trajectory: text of the trajectory file that was played; empty where none was.
        host: name of the recording computer.
        comment: the user's own words.
    """

    robot_text: str
    streams: Mapping[str, Stream]
    events: tuple[Event, ...] = ()
    complete: bool = True
    path: Path | None = None
    urdf_text: str = ""
    created: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)
    trajectory: str = ""
    host: str = ""
    comment: str = ""

    @property
    def label(self) -> str:
        """What a message calls this recording."""
        return str(self.path) if self.path is not None else "recording in memory"

    def robot(self) -> RobotFile:
        """The robot file that the recording carries.

        Raises:
            RecordingError: the recording carries none, or one that this version does not accept.
        """
        if not self.robot_text:
            raise RecordingError("carries no robot file", where=self.label, hint="name one with --robot")
        try:
            return parse_robot(
                self.robot_text,
                where="its robot file",
                folder=self.path.parent if self.path is not None else None,
                urdf_text=self.urdf_text or None,
            )
        except RobotFileError as error:
            raise RecordingError(str(error), where=self.label, hint="name another robot file with --robot") from error


def software_versions() -> dict[str, str]:
    """Versions of Python, dynid and what it computes with; 'unknown' for what is not installed as a package."""
    versions = {"python": platform.python_version()}
    for package in ("dynid", "numpy", "scipy", "h5py", "pin"):
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = "unknown"
    return versions


_SYSTEM_REASON = re.compile(r"error message = '([^']+)'")  # how HDF5 wraps what the system said

_EVENT_TYPE = np.dtype(
    [
        ("time", np.float64),
        ("level", h5py.string_dtype("utf-8")),
        ("source", h5py.string_dtype("utf-8")),
        ("message", h5py.string_dtype("utf-8")),
    ]
)


class RecordingWriter:
    """Appends blocks of samples and events to a new recording; a context manager.

    Leaving the `with` block in order marks the recording complete; leaving it by an exception closes the file with
    `complete` false and the exception as an event.

    Raises:
        RecordingError: the file exists already, or its folder cannot be written.
    """

    def __init__(
        self,
        path: Path,
        robot: RobotFile,
        streams: Sequence[StreamLayout],
        *,
        trajectory: str = "",
        comment: str = "",
        overwrite: bool = False,
    ) -> None:
        if path.exists() and not overwrite:
            raise RecordingError("the file exists already", where=str(path), hint="choose another name or --force")
        try:
            self._file = h5py.File(path, "w", libver="latest")
        except OSError as error:
            raise RecordingError(f"cannot be created: {_reason(error)}", where=str(path)) from error
        self.path = path
        self._layouts = {layout.name: layout for layout in streams}
        self._write_attributes(robot, trajectory, comment)
        group = self._file.create_group("streams")
        for layout in streams:
            self._create_stream(group, layout)
        self._file.create_dataset("events", (0,), maxshape=(None,), dtype=_EVENT_TYPE, chunks=(EVENT_CHUNK_ROWS,))

    def _write_attributes(self, robot: RobotFile, trajectory: str, comment: str) -> None:
        attributes = self._file.attrs
        attributes["dynid_schema"] = SCHEMA_VERSION
        attributes["robot"] = robot.text
        attributes["urdf"] = robot.urdf_text or ""
        attributes["created"] = datetime.now(UTC).isoformat(timespec="seconds")
        attributes["versions"] = json.dumps(software_versions())
        attributes["trajectory"] = trajectory
        attributes["host"] = platform.node()
        attributes["comment"] = comment
        attributes["complete"] = False

    def _create_stream(self, parent: Any, layout: StreamLayout) -> None:
        group = parent.create_group(layout.name)
        rows = round(min(max(layout.rate * CHUNK_SECONDS, 1.0), MAX_CHUNK_ROWS)) if layout.rate > 0 else 1000
        clocks = (("time", "the source's own clock"), ("host_time", "the host's monotonic clock"))
        for name, description in clocks:
            dataset = group.create_dataset(name, (0,), maxshape=(None,), dtype=np.float64, chunks=(rows,))
            dataset.attrs["unit"] = "s"
            dataset.attrs["description"] = description
        group["time"].make_scale("time")
        for channel in layout.channels:
            width = len(channel.columns)
            dataset = group.create_dataset(
                channel.quantity, (0, width), maxshape=(None, width), dtype=np.float64, chunks=(rows, width)
            )
            dataset.attrs["unit"] = channel.unit
            dataset.attrs["description"] = channel.description
            dataset.attrs["joints"] = list(channel.columns)
            dataset.dims[0].attach_scale(group["time"])
            dataset.dims[0].label = "time"
            dataset.dims[1].label = "joint"

    def append(self, stream: str, time: FloatArray, host_time: FloatArray, blocks: Mapping[str, FloatArray]) -> None:
        """Append N samples of one stream: `time` and `host_time` (N,) [s], `blocks` quantity → (N, n).

        Raises:
            ValueError: a quantity is missing or has another shape than the stream's layout says.
            RecordingError: the file cannot be written any more (full disk).
        """
        layout = self._layouts[stream]
        if set(blocks) != {channel.quantity for channel in layout.channels}:
            raise ValueError(f"stream '{stream}' takes {[c.quantity for c in layout.channels]}, not {sorted(blocks)}")
        count = len(time)
        for channel in layout.channels:
            if np.shape(blocks[channel.quantity]) != (count, len(channel.columns)):
                raise ValueError(f"{stream}/{channel.quantity}: shape {np.shape(blocks[channel.quantity])}")
        group = self._file["streams"][stream]
        try:
            for name, values in (("time", time), ("host_time", host_time), *blocks.items()):
                dataset = group[name]
                start = dataset.shape[0]
                dataset.resize(start + count, axis=0)
                dataset[start:] = values
        except OSError as error:
            raise RecordingError(f"cannot be written: {_reason(error)}", where=str(self.path)) from error

    def event(self, time: float, level: Level, source: str, message: str) -> None:
        """Append an event; `time` [s] in the clock of the stream that it concerns."""
        events = self._file["events"]
        events.resize(events.shape[0] + 1, axis=0)
        # HDF5 texts end at the first NUL, and h5py refuses them.
        row = (time, level, source.replace("\0", " "), message.replace("\0", " "))
        events[-1:] = np.array([row], dtype=_EVENT_TYPE)

    def keep_origin(self, recording: Recording) -> None:
        """State where and when the samples were taken, in place of here and now; empty entries change nothing."""
        origin = {
            "created": recording.created,
            "host": recording.host,
            "versions": json.dumps(dict(recording.versions)) if recording.versions else "",
        }
        self._file.attrs.update({name: text for name, text in origin.items() if text})

    def flush(self) -> None:
        """Hand everything written so far to the operating system."""
        self._file.flush()

    def close(self, *, complete: bool) -> None:
        """Close the file and say whether the recording ended in order."""
        if not self._file.id.valid:
            return
        self._file.attrs["complete"] = complete
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if error is not None and self._file.id.valid:
            self.event(float("nan"), "error", "recorder", str(error) or type(error).__name__)
        self.close(complete=error is None)


def write_recording(path: Path, recording: Recording, *, overwrite: bool = False) -> None:
    """Write a recording from memory, with its own `created`, `host`, `versions` and `complete`.

    Raises:
        RecordingError: as `RecordingWriter` does, or the recording carries no robot file.
    """
    layouts = [
        StreamLayout(
            name=stream.name,
            channels=tuple(
                ChannelLayout(channel.quantity, channel.columns, channel.unit, channel.description)
                for channel in stream.channels.values()
            ),
            rate=_nominal_rate(stream.time),
        )
        for stream in recording.streams.values()
    ]
    with RecordingWriter(
        path,
        recording.robot(),
        layouts,
        trajectory=recording.trajectory,
        comment=recording.comment,
        overwrite=overwrite,
    ) as writer:
        for stream in recording.streams.values():
            blocks = {quantity: channel.values for quantity, channel in stream.channels.items()}
            writer.append(stream.name, stream.time, stream.host_time, blocks)
        for event in recording.events:
            writer.event(event.time, event.level, event.source, event.message)
        writer.keep_origin(recording)
        writer.close(complete=recording.complete)


def _nominal_rate(time: FloatArray) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        steps = np.diff(time[np.isfinite(time)])
        period = float(np.median(steps)) if len(steps) else 0.0
    return 1.0 / period if 0 < period < np.inf else 0.0


def read_recording(path: str | Path) -> Recording:
    """Read a whole recording.

    Raises:
        RecordingError: no such file; not HDF5; truncated; not written by dynid; newer schema; half-written streams.
    """
    path = Path(path)
    where = str(path)
    if not path.is_file():
        raise RecordingError("no such file" if not path.exists() else "is not a file", where=where)
    if path.stat().st_size == 0:
        raise RecordingError("is empty (0 bytes)", where=where, hint="copy it again from its source")
    if not _has_hdf5_signature(path):
        raise RecordingError(
            "is not an HDF5 file", where=where, hint="take over another format with: dynid import FILE --robot ROBOT"
        )
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise RecordingError(
            f"is truncated or still open in a writer: {_reason(error)}",
            where=where,
            hint="copy it again from its source",
        ) from error
    with file:
        try:
            return _read(file, path)
        except (OSError, LookupError, RuntimeError, TypeError, ValueError, AttributeError, MemoryError) as error:
            # h5py raises any of these on objects of another kind or on broken structures.
            raise RecordingError(
                f"is damaged: {_reason(error)}", where=where, hint="copy it again from its source"
            ) from error


def _has_hdf5_signature(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return file.read(8) == b"\x89HDF\r\n\x1a\n"
    except OSError as error:
        raise RecordingError(f"cannot be read: {error.strerror}", where=str(path)) from error


def _read(file: Any, path: Path) -> Recording:
    where = str(path)
    attributes = file.attrs
    if "dynid_schema" not in attributes:
        raise RecordingError(
            "is an HDF5 file, but not a dynid recording (no attribute 'dynid_schema')",
            where=where,
            hint="take it over with: dynid import FILE --robot ROBOT",
        )
    schema = attributes["dynid_schema"]
    if not isinstance(schema, (int, np.integer)) or schema < 1:
        raise RecordingError(f"has the unreadable schema version {schema!r}", where=where)
    if schema > SCHEMA_VERSION:
        raise RecordingError(
            f"was written with schema version {schema}, this dynid reads up to {SCHEMA_VERSION}",
            where=where,
            hint="update dynid",
        )
    if "streams" not in file or not isinstance(file["streams"], h5py.Group) or len(file["streams"]) == 0:
        raise RecordingError("holds no stream: its writer stopped before the first one", where=where)
    return Recording(
        path=path,
        robot_text=str(attributes.get("robot", "")),
        urdf_text=str(attributes.get("urdf", "")),
        created=str(attributes.get("created", "")),
        versions=_read_versions(attributes.get("versions", "{}")),
        trajectory=str(attributes.get("trajectory", "")),
        host=str(attributes.get("host", "")),
        comment=str(attributes.get("comment", "")),
        complete=bool(attributes.get("complete", False)),
        streams={name: _read_stream(group, f"{where}: /streams/{name}") for name, group in file["streams"].items()},
        events=_read_events(file),
    )


def _read_versions(text: Any) -> dict[str, str]:
    try:
        versions = json.loads(str(text))
    except json.JSONDecodeError:
        return {}
    return {str(key): str(value) for key, value in versions.items()} if isinstance(versions, dict) else {}


def _read_stream(group: Any, where: str) -> Stream:
    if not isinstance(group, h5py.Group) or "time" not in group:
        raise RecordingError("has no dataset 'time'", where=where)
    for name, dataset in group.items():
        if not isinstance(dataset, h5py.Dataset) or not dataset.shape:
            raise RecordingError(f"'{name}' is not a dataset with a row a sample", where=where)
    lengths = {name: dataset.shape[0] for name, dataset in group.items()}
    count = lengths["time"]
    if any(length != count for length in lengths.values()):
        # A crash between two appends leaves columns of different length; the common part is sound.
        if min(lengths.values()) == 0:
            raise RecordingError(f"is half-written: rows per dataset {lengths}", where=where)
        count = min(lengths.values())
    for clock in ("time", "host_time"):
        if clock in group and group[clock].ndim != 1:
            raise RecordingError(f"'{clock}' has shape {group[clock].shape}; (N,) expected", where=where)
    time = _read_clock(group, "time", count)
    host_time = _read_clock(group, "host_time", count) if "host_time" in group else time
    channels = {}
    for name, dataset in group.items():
        if name in ("time", "host_time"):
            continue
        if dataset.ndim != 2 or not np.issubdtype(dataset.dtype, np.number):
            raise RecordingError(
                f"'{name}' has shape {dataset.shape}, type {dataset.dtype}; (N, n) numbers expected", where=where
            )
        columns = tuple(str(column) for column in dataset.attrs.get("joints", ()))
        if len(columns) != dataset.shape[1]:
            raise RecordingError(
                f"'{name}' has {dataset.shape[1]} columns, but its attribute 'joints' names {len(columns)}", where=where
            )
        channels[name] = Channel(
            quantity=name,
            values=np.asarray(dataset[:count], dtype=np.float64),
            unit=str(dataset.attrs.get("unit", "")),
            columns=columns,
            description=str(dataset.attrs.get("description", "")),
        )
    return Stream(name=group.name.rsplit("/", 1)[-1], time=time, host_time=host_time, channels=channels)


def _read_clock(group: Any, name: str, count: int) -> FloatArray:
    return np.asarray(group[name][:count], dtype=np.float64)


def _read_events(file: Any) -> tuple[Event, ...]:
    if "events" not in file:
        return ()

    def text(value: Any) -> str:
        return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)

    return tuple(
        Event(float(row["time"]), text(row["level"]), text(row["source"]), text(row["message"]))  # type: ignore[arg-type]
        for row in file["events"][:]
    )


def _reason(error: BaseException) -> str:
    """The first sentence of an HDF5 or system error."""
    text = str(getattr(error, "strerror", None) or error).strip().strip("'\"")
    system = _SYSTEM_REASON.search(text)
    if system is not None:
        return system[1]
    return text.splitlines()[0] if text else type(error).__name__
