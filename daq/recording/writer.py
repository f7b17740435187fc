"""Writing a recording: everything is created first, then only appended to."""

from __future__ import annotations

import json
import os
import platform
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import h5py
import numpy as np

from daq.output_files import DISK_ERRORS, check_outputs, unfinished_name
from daq.recording.failsafe_file import FailsafeFile
from daq.recording.hdf5_reason import hdf5_reason
from daq.recording.recording import SCHEMA_VERSION, Level, Recording, software_versions
from daq.robot.loader import RobotFile
from drivers.errors import DiskError, DynidError, RecordingError
from drivers.streams import ChannelLayout, FloatArray, StreamLayout

CHUNK_SECONDS = 0.5
"""Duration of a chunk [s], and so the most that a crash can cost a recorder that flushes whole chunks."""
MAX_CHUNK_ROWS = 20_000  # a nominal rate that came out of nearly equal stamps must not size a chunk
EVENT_CHUNK_ROWS = 64
CREATION_ROOM = 64 * 1024
"""Bytes that a recording surely fits into, beside its texts and the first chunk of each stream."""

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


def _try_bytes(path: Path, count: int) -> None:
    """Write so many bytes beside a recording and forget them.

    Where the header or a stream's first chunk are refused, HDF5 (2.0) crashes; where later ones are, it does not.

    Raises:
        DiskError: the disk is full, or fails.
        RecordingError: the system refuses them.
    """
    try:
        with tempfile.TemporaryFile(dir=path.parent, buffering=0) as trial:
            written = trial.write(bytes(count))
            if written < count:
                trial.write(bytes(count - written))  # says why
    except OSError as error:
        raise _refused(error, path) from error


def _chunk_bytes(layout: StreamLayout) -> int:
    columns = 2 + sum(len(channel.columns) for channel in layout.channels)
    return chunk_rows(layout.rate) * columns * np.dtype(np.float64).itemsize


def _null_device() -> int:
    return os.open(os.devnull, os.O_RDWR)


def _memory_file() -> int:
    return os.memfd_create("abandoned") if hasattr(os, "memfd_create") else _null_device()


class RecordingWriter:
    """Appends blocks of samples and events to a new recording; a context manager.

    Leaving the `with` block in order marks the recording complete; leaving it by an exception closes the file with
    `complete` false and the exception as an event.

    Raises:
        UsageError: the file exists already, is no regular file, or its folder cannot be written.
        RecordingError: it cannot be created.
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
        through: FailsafeFile | None = None,
    ) -> None:
        if through is None:
            check_outputs([path], overwrite=overwrite)
        self._through = through
        texts = robot.text + (robot.urdf_text or "") + trajectory + comment
        if through is None:
            _try_bytes(path, CREATION_ROOM + len(texts.encode()) + sum(_chunk_bytes(layout) for layout in streams))
        try:
            if overwrite:
                path.unlink(missing_ok=True)  # not truncated: it may be known by another name too
            mode = "x" if through is None else "w"
            self._file = h5py.File(path if through is None else through, mode, libver="latest")
        except OSError as error:
            raise RecordingError(f"cannot be created: {hdf5_reason(error)}", where=str(path)) from error
        self.path = path
        self._layouts = {layout.name: layout for layout in streams}
        # Kept open: closing a dataset that a full disk refuses leaves HDF5 in a state in which it crashes at exit.
        self._datasets: dict[str, dict[str, Any]] = {layout.name: {} for layout in streams}
        try:
            self._write_attributes(robot, trajectory, speed_scale, comment)
            group = self._file.create_group("streams")
            for layout in streams:
                self._create_stream(group, layout)
            self._events = self._file.create_dataset(
                "events", (0,), maxshape=(None,), dtype=_EVENT_TYPE, chunks=(EVENT_CHUNK_ROWS,)
            )
        except (OSError, RuntimeError) as error:
            raise self._creation_error(error) from error

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

    def _create_stream(self, parent: Any, layout: StreamLayout) -> None:
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
            dataset.attrs["unit"] = channel.unit
            dataset.attrs["description"] = channel.description
            dataset.attrs["joints"] = list(channel.columns)
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
            RecordingError: the file cannot be written; it is removed.
        """
        try:
            self._file.swmr_mode = True
        except (OSError, RuntimeError) as error:
            raise self._creation_error(error) from error

    def _creation_error(self, error: BaseException) -> RecordingError:
        """Close a file that holds nothing yet, and remove it."""
        self.abandon()
        with suppress(OSError):
            self.path.unlink()
        return RecordingError(f"cannot be created: {hdf5_reason(error)}", where=str(self.path))

    def _check_disk(self) -> None:
        """Raise what the disk refused, which was kept from HDF5."""
        if self._through is not None and self._through.failure is not None:
            raise self._through.failure

    def _write_error(self, error: BaseException) -> RecordingError:
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

    def close(self, *, complete: bool) -> None:
        """Close the file and store whether the recording is complete.

        Raises:
            RecordingError: the file cannot be written any more (full disk); what was flushed can be recovered.
        """
        if not self._file.id.valid:
            return
        try:
            self._file.attrs["complete"] = complete
            self._file.close()
        except (OSError, RuntimeError) as error:
            self.abandon()
            raise self._write_error(error) from error

    def abandon(self) -> None:
        """Close a file that cannot be written any more; flushed data remain.

        HDF5 keeps a file open whose close failed, tries again at the interpreter's exit and crashes there (seen with
        HDF5 2.0, on a full disk and at a file size limit). So what it still wants to write goes nowhere.
        """
        if self._through is not None:  # which takes all that HDF5 still wants to write
            self._file.close()
            return
        # The null device takes every byte, but refuses to be given a length, as a close may want. Memory takes a
        # length, but is bound by a file size limit. What one refused is not tried with the next.
        for make_sink in (_null_device, _memory_file, _null_device):
            if not self._file.id.valid:
                return
            nowhere = make_sink()
            try:
                os.dup2(nowhere, self._file.id.get_vfd_handle())
            finally:
                os.close(nowhere)
            with suppress(OSError, RuntimeError):
                self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if error is not None and self._file.id.valid:
            try:
                self.event(float("nan"), "error", "recorder", str(error) or type(error).__name__)
                self.close(complete=False)
            except RecordingError:  # the error on its way is the one to tell
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
        RecordingError: the recording carries no robot file.
        DiskError: the disk is full or fails; a file that existed is as it was.

    Example:
        >>> import dynid, pathlib, tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder, "run.h5")
        ...     dynid.write_recording(path, dynid.simulate("ur5e", duration=2.0))
        ...     len(dynid.read_recording(path).streams["joints"].time)
        1000
    """
    path = Path(path)
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
    check_outputs([path], overwrite=overwrite)
    unfinished = unfinished_name(path)
    try:
        file = FailsafeFile(unfinished)
    except OSError as error:
        raise _refused(error, path) from error
    try:
        with RecordingWriter(
            unfinished,
            recording.robot(),
            layouts,
            trajectory=recording.trajectory,
            speed_scale=recording.speed_scale,
            comment=recording.comment,
            through=file,
        ) as writer:
            for stream in recording.streams.values():
                blocks = {quantity: channel.values for quantity, channel in stream.channels.items()}
                writer.append(stream.name, stream.time, stream.host_time, blocks)
            for event in recording.events:
                writer.event(event.time, event.level, event.source, event.message)
            writer.keep_origin(recording)
            writer.close(complete=recording.complete)
        file.close()
        if file.failure is not None:
            raise file.failure
        unfinished.replace(path)
    except OSError as error:
        raise _refused(error, path) from error
    except RecordingError as error:
        if file.failure is not None:
            raise _refused(file.failure, path) from error
        raise RecordingError(error.message, where=str(path), hint=error.hint) from error
    finally:
        file.close()
        unfinished.unlink(missing_ok=True)


def _refused(error: OSError, path: Path) -> DynidError:
    said = f"cannot be written: {error.strerror}"
    if error.errno in DISK_ERRORS:
        return DiskError(said, where=str(path), hint="make room on the disk; nothing was changed")
    return RecordingError(said, where=str(path), hint="choose another place")


def _nominal_rate(time: FloatArray) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        steps = np.diff(time[np.isfinite(time)])
        period = float(np.median(steps)) if len(steps) else 0.0
    return 1.0 / period if 0 < period < np.inf else 0.0
