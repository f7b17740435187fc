"""Rescue of a recording whose writer crashed: all flushed data, in a new file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np

from daq.output_files import check_outputs, unfinished_files
from daq.recording.hdf5_bounds import hdf5_reason
from daq.recording.reader import read_open_recording
from daq.recording.recording import Event, Recording, Stream
from daq.recording.writer import write_recording
from drivers.core.errors import RecordingError, UsageError
from drivers.core.files import RECORDING_FILE, check_input
from drivers.core.reading_process import read_apart

WAITING_LIMIT = 20.0
"""Time limit [s] for reading a small recording; a larger one has its size over READ_SPEED [B/s] more.

HDF5 waits longer and longer for a writer to mend what is damaged.
"""
READ_SPEED = 5e6


@dataclass(frozen=True)
class Recovered:
    """A rescued recording.

    Attributes:
        recording: as written to the new file.
        cut: stream → rows that the file announced but that were not written.
    """

    recording: Recording
    cut: dict[str, int]


def follow_recording(path: Path) -> Recording:
    """The flushed data of a recording that is still being written, or whose writer crashed.

    Raises:
        RecordingError: not a recording, or nothing of it can be read.
    """
    try:
        with h5py.File(path, "r", libver="latest", swmr=True) as file:
            return read_open_recording(file, path)
    except (OSError, RuntimeError) as error:
        raise RecordingError(f"nothing can be rescued: {hdf5_reason(error)}", where=str(path)) from error


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


def recover(path: Path, out: Path, *, overwrite: bool = False) -> Recovered:
    """Copy the readable data of a half-written recording into a new file, which states this in an event.

    The recording stays incomplete (`complete` false): its readers should know that it was cut off.

    Raises:
        RecordingError: nothing can be read, or HDF5 loops or crashes over it.
        UsageError: the new file is the old one, exists already or cannot be written.
    """
    check_input(path, RECORDING_FILE, RecordingError)
    check_outputs([out], [path], overwrite=overwrite)
    waiting_limit = WAITING_LIMIT + path.stat().st_size / READ_SPEED
    rest = read_apart(lambda progress: follow_recording(path), path, RecordingError, waiting_limit=waiting_limit)
    streams, cut = {}, {}
    for name, stream in rest.streams.items():
        streams[name], cut[name] = _without_unwritten_rows(stream)
    lost = ", ".join(f"{count} rows of {name}" for name, count in cut.items() if count)
    message = f"recovered from {path.name}, whose writer did not close it" + (f"; unwritten: {lost}" if lost else "")
    events = (*rest.events, Event(float("nan"), "warning", "recover", message))
    recording = replace(rest, streams=streams, events=events, complete=False)
    write_recording(out, recording, overwrite=overwrite)
    return Recovered(replace(recording, path=out), cut)


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
