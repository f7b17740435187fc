"""Rescue of a recording whose writer crashed: all flushed data, in a new file."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import h5py
import numpy as np

from daq.output_files import check_outputs, unfinished_files
from daq.recording.hdf5_bounds import Hdf5Bounds, hdf5_reason
from daq.recording.reader import read_events, read_open_recording
from daq.recording.recording import Event, Recording, Stream
from daq.recording.writer import RecordingWriter, layouts_of, write_recording
from drivers.core.errors import RecordingError, UsageError
from drivers.core.files import LONG_RECORDING_FILE, RECORDING_FILE, check_input
from drivers.core.reading_process import read_apart

WAITING_LIMIT = 20.0
"""Time limit [s] for reading a small recording; a larger one has its size over READ_SPEED [B/s] more.

HDF5 waits longer and longer for a writer to mend what is damaged.
"""
READ_SPEED = 5e6
AT_ONCE = 600.0
"""Seconds of a large recording that are copied at a time; far more than a chunk lasts."""

_Read = TypeVar("_Read")


def follow_recording(path: Path, part: tuple[float, float] | None = None) -> Recording:
    """The flushed data of a recording that is still being written, or whose writer crashed.

    A part is from and until [s] after the first stamp.

    Raises:
        RecordingError: not a recording, or nothing of it can be read.
    """
    return _followed(path, lambda file: read_open_recording(file, path, part))


def _followed(path: Path, read: Callable[[Any], _Read]) -> _Read:
    try:
        with h5py.File(path, "r", libver="latest", swmr=True) as file:
            return read(file)
    except (OSError, RuntimeError) as error:
        raise RecordingError(f"nothing can be recovered: {hdf5_reason(error)}", where=str(path)) from error


def half_written(path: Path) -> Path:
    """The file to rescue: this one, or where there is none of that name, the one that was to take its place.

    Raises:
        UsageError: there are several of these.
    """
    unfinished = [] if path.exists() else unfinished_files(path)
    if len(unfinished) > 1:
        names = ", ".join(str(file) for file in unfinished)
        raise UsageError(
            f"no such file, but {len(unfinished)} that are unfinished", where=str(path), hint=f"name one: {names}"
        )
    return unfinished[0] if unfinished else path


def recover(path: Path, out: Path, *, overwrite: bool = False) -> dict[str, int]:
    """Copy the readable data of a half-written recording into a new file, which states this in an event.

    The recording stays incomplete (`complete` false): its readers should know that it was cut off.

    Returns:
        Stream → rows that the file announced but that were not written.

    Raises:
        RecordingError: nothing can be read, or HDF5 loops or crashes over it.
        UsageError: the new file is the old one, exists already or cannot be written.
    """
    check_input(path, LONG_RECORDING_FILE, RecordingError)
    check_outputs([out], [path], overwrite=overwrite)
    if path.stat().st_size > RECORDING_FILE.largest:
        return _recovered_in_parts(path, out, overwrite=overwrite)
    rest = _read_apart(path, lambda: follow_recording(path))
    streams, cut = {}, {}
    for name, stream in rest.streams.items():
        streams[name], cut[name] = _without_unwritten_rows(stream)
    recording = replace(rest, streams=streams, events=(*rest.events, _rescue(path, cut)), complete=False)
    write_recording(out, recording, overwrite=overwrite)
    return cut


def _recovered_in_parts(path: Path, out: Path, *, overwrite: bool) -> dict[str, int]:
    """The same of a file that is too large for the memory."""
    extent = _read_apart(path, lambda: _followed(path, lambda file: _extent(file, path)))
    first = _read_apart(path, lambda: follow_recording(path, (0.0, AT_ONCE)))
    writer = RecordingWriter(
        out,
        first.robot(),
        layouts_of(first),
        trajectory=first.trajectory,
        speed_scale=first.speed_scale,
        comment=first.comment,
        overwrite=overwrite,
    )
    try:
        cut = dict(extent.rows)
        # What was not written is at the end; a part that has nothing else would look like a channel never filled.
        end = _read_apart(path, lambda: follow_recording(path, (extent.seconds - AT_ONCE, extent.seconds + AT_ONCE)))
        written = {name: _without_unwritten_rows(stream)[0].time for name, stream in end.streams.items()}
        for begin in np.arange(0.0, extent.seconds + AT_ONCE, AT_ONCE).tolist():
            part = _read_apart(path, lambda begin=begin: _part(path, begin))  # type: ignore[misc]
            for name, stream in {} if part is None else part.streams.items():
                last = written[name][-1] if len(written[name]) else np.inf
                count = int(np.searchsorted(stream.time, last, side="right"))
                values = {quantity: channel.values[:count] for quantity, channel in stream.channels.items()}
                writer.append(name, stream.time[:count], stream.host_time[:count], values)
                cut[name] -= count
        for event in (*extent.events, _rescue(path, cut)):
            writer.event(event.time, event.level, event.source, event.message)
        writer.keep_origin(first)
        writer.finish(complete=False)
        writer.take_place(overwrite=overwrite)
    finally:
        writer.discard()
    return cut


def _part(path: Path, begin: float) -> Recording | None:
    """A part of a recording; None where it has no sample."""
    try:
        return follow_recording(path, (begin, begin + AT_ONCE))
    except RecordingError as error:
        if "has no sample" in error.message:
            return None
        raise


@dataclass(frozen=True)
class _Extent:
    """What a recording holds: rows per stream, the seconds of the longest, and all events."""

    rows: dict[str, int]
    seconds: float
    events: tuple[Event, ...]


def _extent(file: Any, path: Path) -> _Extent:
    rows, ends = {}, [np.inf, -np.inf]
    for name, group in file["streams"].items():
        time = group["time"]
        rows[name] = min(len(dataset) for dataset in group.values())
        if stamped := bisect_left(time, np.inf, hi=rows[name]):  # rows that were announced, but not written, are NaN
            ends = [min(ends[0], float(time[0])), max(ends[1], float(time[stamped - 1]))]
    events = read_events(file.get("events"), Hdf5Bounds(path, RecordingError))
    return _Extent(rows, max(ends[1] - ends[0], 0.0), events)


def _read_apart(path: Path, read: Callable[[], _Read]) -> _Read:
    waiting_limit = WAITING_LIMIT + path.stat().st_size / READ_SPEED
    return read_apart(lambda progress: read(), path, RecordingError, waiting_limit=waiting_limit)


def _rescue(path: Path, cut: Mapping[str, int]) -> Event:
    lost = ", ".join(f"{count} rows of {name}" for name, count in cut.items() if count)
    message = f"recovered from {path.name}, whose writer did not close it" + (f"; unwritten: {lost}" if lost else "")
    return Event(float("nan"), "warning", "recover", message)


def _without_unwritten_rows(stream: Stream) -> tuple[Stream, int]:
    """A stream up to its first row without a time stamp: HDF5 may lengthen a dataset before its rows are on disk."""
    missing = np.isnan(stream.time) | np.isnan(stream.host_time)
    for channel in stream.channels.values():
        # Datasets are written one after the other: a refused write leaves the later ones at the fill value. A channel
        # that is all NaN from its first sample on is one that the source never filled.
        empty = np.all(np.isnan(channel.values), axis=1)
        if not np.all(empty):
            missing |= empty & (np.arange(len(empty)) > np.flatnonzero(~empty)[-1])
    unwritten = np.flatnonzero(missing)
    count = int(unwritten[0]) if len(unwritten) else len(stream.time)
    channels = {name: replace(channel, values=channel.values[:count]) for name, channel in stream.channels.items()}
    return Stream(stream.name, stream.time[:count], stream.host_time[:count], channels), len(stream.time) - count
