"""Writing a recording: everything is created first, then only appended to."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import h5py
import numpy as np

from daq.output_files import DISK_ERRORS, check_outputs, take_place, unfinished_name
from daq.recording.growing_file import SPARE, FailsafeFile, GrowingFile
from daq.recording.hdf5_bounds import hdf5_reason
from daq.recording.recording import SCHEMA_VERSION, Level, Recording
from daq.robot.loader import RobotFile
from daq.robot.schema import Robot
from drivers.core.arrays import FloatArray
from drivers.core.errors import DiskError, DynidError, RecordingError, UsageError
from drivers.core.files import RECORDING_FILE, given_kind, path_of, size_text
from drivers.core.software import software_versions
from drivers.streams import UNITS, ChannelLayout, StreamLayout

CHUNK_SECONDS = 0.5
"""Duration of a chunk [s], and so the most that a crash can cost a recorder that flushes whole chunks."""
MAX_CHUNK_ROWS = 20_000  # a nominal rate that came out of nearly equal stamps must not size a chunk
EVENT_CHUNK_ROWS = 64

_EVENT_TYPE = np.dtype(
    [
        ("time", np.float64),
        ("level", h5py.string_dtype("utf-8")),
        ("source", h5py.string_dtype("utf-8")),
        ("message", h5py.string_dtype("utf-8")),
    ]
)


def chunk_rows(rate: float) -> int:
    """Rows of a chunk of a stream with this nominal rate [Hz]; 1000 where it is unknown (0)."""
    return round(min(max(rate * CHUNK_SECONDS, 1.0), MAX_CHUNK_ROWS)) if rate > 0 else 1000


def _bytes_of(layout: StreamLayout, rows: int) -> int:
    columns = 2 + sum(len(channel.columns) for channel in layout.channels)
    whole = rows + 2 * chunk_rows(layout.rate)  # chunks are whole, the first and the last one, too
    return whole * columns * np.dtype(np.float64).itemsize


class RecordingWriter:
    """Appends blocks of samples and events to a new recording; a context manager.

    It is written under an unfinished name beside its place, which it takes when it is closed. Leaving the `with` block
    in order marks it complete; leaving it by an exception closes it with `complete` false and the exception as an
    event. Its creation, and all of a recording that is not read while it grows, go through a `FailsafeFile`.

    Raises:
        UsageError: the file exists already, is no regular file, or its folder cannot be written.
        RecordingError: it cannot be created.
        DiskError: the disk is full or fails.
    """

    def __init__(
        self,
        path: Path,
        robot: RobotFile,
        streams: Sequence[StreamLayout],
        *,
        trajectory: str = "",
        speed_scale: float = 1.0,
        comment: str = "",
        overwrite: bool = False,
    ) -> None:
        check_outputs([path], overwrite=overwrite)
        self.path = path
        """Path of the recording once it is closed."""
        self.unfinished = unfinished_name(path)
        """Path until then, and where it could not be closed."""
        self._overwrite = overwrite
        self._layouts = {layout.name: layout for layout in streams}
        self._growing: GrowingFile | None = None
        try:
            self._through = FailsafeFile(self.unfinished)
        except OSError as error:
            raise _refused(error, path) from error
        # Datasets are kept open: closing one that a full disk refuses leaves HDF5 in a state in which it crashes.
        self._datasets: dict[str, dict[str, Any]] = {layout.name: {} for layout in streams}
        self._file = h5py.File(self._through, "w", libver="latest")
        try:
            self._write_attributes(robot, trajectory, speed_scale, comment)
            group = self._file.create_group("streams")
            for layout in streams:
                self._create_stream(group, layout, robot.robot)
            self._events = self._file.create_dataset(
                "events", (0,), maxshape=(None,), dtype=_EVENT_TYPE, chunks=(EVENT_CHUNK_ROWS,)
            )
            self._check_disk()
        except BaseException as error:
            self.discard()
            if isinstance(error, (OSError, RuntimeError)):
                raise self._write_error(error) from error
            raise

    def _write_attributes(self, robot: RobotFile, trajectory: str, speed_scale: float, comment: str) -> None:
        attributes = self._file.attrs
        attributes["dynid_schema"] = SCHEMA_VERSION
        attributes["robot"] = robot.text
        attributes["urdf"] = robot.urdf_text or ""
        attributes["created"] = datetime.now(UTC).isoformat(timespec="seconds")
        attributes["versions"] = json.dumps(software_versions())
        attributes["trajectory"] = trajectory
        attributes["speed_scale"] = speed_scale
        attributes["host"] = platform.node()
        attributes["comment"] = comment
        attributes["complete"] = False

    def _create_stream(self, parent: Any, layout: StreamLayout, robot: Robot) -> None:
        group = parent.create_group(layout.name)
        rows = chunk_rows(layout.rate)
        clocks = (("time", "the source's own clock"), ("host_time", "the host's monotonic clock"))
        for name, description in clocks:
            dataset = group.create_dataset(
                name, (0,), maxshape=(None,), dtype=np.float64, chunks=(rows,), fillvalue=np.nan
            )
            self._datasets[layout.name][name] = dataset
            dataset.attrs["unit"] = "s"
            dataset.attrs["description"] = description
        group["time"].make_scale("time")
        for channel in layout.channels:
            width = len(channel.columns)
            dataset = group.create_dataset(
                channel.quantity,
                (0, width),
                maxshape=(None, width),
                dtype=np.float64,
                chunks=(rows, width),
                fillvalue=np.nan,  # rows of a crash that were announced but not written must not look like samples
            )
            self._datasets[layout.name][channel.quantity] = dataset
            in_si = channel.unit == UNITS.get(channel.quantity)
            dataset.attrs["unit"] = robot.column_unit(channel.unit, channel.columns) if in_si else channel.unit
            dataset.attrs["description"] = channel.description
            dataset.attrs["joints"] = list(channel.columns)
            if channel.magnitude:
                dataset.attrs["magnitude"] = True
            dataset.dims[0].attach_scale(group["time"])
            dataset.dims[0].label = "time"
            dataset.dims[1].label = "joint"

    def append(
        self, stream: str, time: FloatArray, host_time: FloatArray, quantities: Mapping[str, FloatArray]
    ) -> None:
        """Append N samples of one stream: `time` and `host_time` (N,) [s], `quantities` quantity → (N, n).

        Raises:
            ValueError: a quantity is missing or has another shape than in the stream's layout.
            RecordingError: the file cannot be written any more (full disk).
        """
        layout = self._layouts[stream]
        if set(quantities) != {channel.quantity for channel in layout.channels}:
            raise ValueError(
                f"stream '{stream}' takes {[c.quantity for c in layout.channels]}, not {sorted(quantities)}"
            )
        count = len(time)
        for channel in layout.channels:
            if np.shape(quantities[channel.quantity]) != (count, len(channel.columns)):
                raise ValueError(f"{stream}/{channel.quantity}: shape {np.shape(quantities[channel.quantity])}")
        datasets = self._datasets[stream]
        try:
            for name, values in (("time", time), ("host_time", host_time), *quantities.items()):
                dataset = datasets[name]
                start = dataset.shape[0]
                dataset.resize(start + count, axis=0)
                dataset[start:] = values
                self._check_disk()
        except (OSError, RuntimeError) as error:
            raise self._write_error(error) from error

    def allow_readers(self) -> None:
        """Allow readers while the file grows (HDF5's SWMR mode); only once, before the first rows.

        Raises:
            DiskError: there is no space for it to grow; it is removed.
            RecordingError: HDF5 refuses; it is removed.
        """
        try:
            self._file.close()
            self._through.close()
            self._check_disk()
            self._growing = GrowingFile(self.unfinished)
            self._file = self._growing.file
            for stream, datasets in self._datasets.items():
                for name in datasets:
                    datasets[name] = self._file[f"streams/{stream}/{name}"]
            self._events = self._file["events"]
            self._growing.allow_readers()
        except (OSError, RuntimeError) as error:
            self.discard()
            raise self._write_error(error) from error
        except DiskError as error:
            self.discard()
            raise DiskError(error.message, where=str(self.path), hint=error.hint) from error

    def reserve(self, rows: Mapping[str, int], texts: int = 0) -> None:
        """See to it that there is space for rows of streams, and for texts of so many bytes, before they are appended.

        Raises:
            DiskError: the disk is full, or the recording would be larger than what is read; it can still be closed.
        """
        if self._growing is not None:
            try:
                self._growing.reserve(self.bytes_of(rows) + texts)
            except DiskError as error:
                raise DiskError(error.message, where=str(self.path), hint=error.hint) from error

    def bytes_of(self, rows: Mapping[str, int]) -> int:
        """Return what rows of streams need on the disk at most [B]."""
        return sum(_bytes_of(self._layouts[stream], count) for stream, count in rows.items())

    def _check_disk(self) -> None:
        """Raise what the disk refused, which was kept from HDF5."""
        if self._growing is None and self._through.failure is not None:
            raise self._through.failure

    def _write_error(self, error: BaseException) -> DynidError:
        refusal = self._through.failure if self._growing is None else None
        if refusal is not None:
            return _refused(refusal, self.path)
        return RecordingError(f"cannot be written: {hdf5_reason(error)}", where=str(self.path))

    def event(self, time: float, level: Level, source: str, message: str) -> None:
        """Append an event; `time` [s] in the clock of the stream that it concerns."""
        events = self._events
        # HDF5 texts end at the first NUL, and h5py refuses them.
        row = (time, level, source.replace("\0", " "), message.replace("\0", " "))
        try:
            events.resize(events.shape[0] + 1, axis=0)
            events[-1:] = np.array([row], dtype=_EVENT_TYPE)
            self._check_disk()
        except (OSError, RuntimeError) as error:
            raise self._write_error(error) from error

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
        try:
            self._file.flush()
        except (OSError, RuntimeError) as error:
            raise self._write_error(error) from error

    def finish(self, *, complete: bool) -> None:
        """Close the file, which keeps its unfinished name, and store whether the recording is complete.

        Raises:
            RecordingError, DiskError: the file cannot be written any more. One that others may read remains, and what
                was flushed of it can be recovered.
        """
        if not self._file.id.valid:
            return
        try:
            self._file.attrs["complete"] = complete
            if self._growing is not None:
                self._growing.close()
            else:
                self._file.close()
                self._through.close()
            self._check_disk()
        except (OSError, RuntimeError) as error:
            if self._growing is not None:
                self.abandon()
            else:
                self.discard()
            raise self._write_error(error) from error

    def take_place(self, *, overwrite: bool) -> None:
        """Give the recording its name, once it is finished.

        Raises:
            DiskError: a file of that name exists by now, or the system refuses; the unfinished name remains.
        """
        try:
            take_place(self.unfinished, self.path, overwrite=overwrite)
        except FileExistsError as error:
            raise DiskError(
                "exists by now and was not replaced", where=str(self.path), hint=f"the recording is {self.unfinished}"
            ) from error
        except OSError as error:
            raise DiskError(
                f"cannot be written: {error.strerror}", where=str(self.path), hint=f"the recording is {self.unfinished}"
            ) from error

    def close(self, *, complete: bool) -> None:
        """Finish the file and give it its name; safe to call twice.

        Raises:
            RecordingError, DiskError: as `finish` and `take_place`.
        """
        if self._file.id.valid:
            self.finish(complete=complete)
            self.take_place(overwrite=self._overwrite)

    def abandon(self) -> None:
        """Close a file that cannot be written any more; flushed data remain, under the unfinished name."""
        if self._growing is not None:
            self._growing.abandon()
        elif self._file.id.valid:
            self._file.close()  # what it still writes is kept from the disk
            self._through.close()

    def discard(self) -> None:
        """Close the file and remove it."""
        self.abandon()
        self._through.close()
        with suppress(OSError):
            self.unfinished.unlink()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if error is not None and self._file.id.valid:
            try:
                self.event(float("nan"), "error", "recorder", str(error) or type(error).__name__)
                self.close(complete=False)
            except DynidError:  # the error on its way is the one to tell
                self.abandon()
            return
        self.close(complete=error is None)


def write_recording(path: str | Path, recording: Recording, *, overwrite: bool = False) -> None:
    """Write a recording from memory, with its own `created`, `host`, `versions` and `complete`; all of it or nothing.

    Args:
        path: of the file (.h5).
        recording: to write.
        overwrite: replace a file that exists.

    Raises:
        UsageError: the file exists already, is no regular file, or its folder cannot be written.
        RecordingError: the recording carries no robot file, or is larger than what is read.
        DiskError: the disk is full or fails; a file that existed is as it was.

    Example:
        >>> import dynid, pathlib, tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder, "run.h5")
        ...     dynid.write_recording(path, dynid.simulate("ur5e", duration=2.0))
        ...     len(dynid.read_recording(path).streams["joints"].time)
        1000
    """
    path = path_of(path)
    if not isinstance(recording, Recording):
        hint = "dynid.Recording.from_dataframe and from_dict make one"
        raise UsageError(f"{given_kind(recording)} is not a recording", hint=hint)
    layouts = layouts_of(recording)
    size = sum(_bytes_of(layout, len(recording.streams[layout.name].time)) for layout in layouts)
    if size + SPARE > RECORDING_FILE.largest:
        largest = size_text(RECORDING_FILE.largest)
        raise RecordingError(f"would be larger than {largest}, the largest that is read", where=str(path))
    writer = RecordingWriter(
        path,
        recording.robot(),
        layouts,
        trajectory=recording.trajectory,
        speed_scale=recording.speed_scale,
        comment=recording.comment,
        overwrite=overwrite,
    )
    try:
        for stream in recording.streams.values():
            blocks = {quantity: channel.values for quantity, channel in stream.channels.items()}
            writer.append(stream.name, stream.time, stream.host_time, blocks)
        for event in recording.events:
            writer.event(event.time, event.level, event.source, event.message)
        writer.keep_origin(recording)
        writer.finish(complete=recording.complete)
        writer.take_place(overwrite=overwrite)
    finally:
        writer.discard()


def layouts_of(recording: Recording) -> list[StreamLayout]:
    """The layouts of its streams, with the rates that the stamps have."""
    return [
        StreamLayout(
            name=stream.name,
            channels=tuple(
                ChannelLayout(channel.quantity, channel.columns, channel.unit, channel.description, channel.magnitude)
                for channel in stream.channels.values()
            ),
            rate=_nominal_rate(stream.time),
        )
        for stream in recording.streams.values()
    ]


def _refused(error: OSError, path: Path) -> DynidError:
    said = f"cannot be written: {error.strerror}"
    if error.errno in DISK_ERRORS:
        return DiskError(said, where=str(path), hint="free some space on the disk; nothing was changed")
    return RecordingError(said, where=str(path), hint="choose another place")


def _nominal_rate(time: FloatArray) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        steps = np.diff(time[np.isfinite(time)])
        period = float(np.median(steps)) if len(steps) else 0.0
    return 1.0 / period if 0 < period < np.inf else 0.0
