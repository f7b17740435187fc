"""Recordings as arguments of a task: one or several, read already or by path."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path

from daq.recording.reader import read_recording
from daq.recording.recording import Recording

Run = Recording | str | PathLike[str]
"""A recording, or the path of one."""

Runs = Run | Sequence[Run]


def recording_of(run: Run) -> Recording:
    """The recording, read where a path is given.

    Raises:
        RecordingError: it cannot be read.
    """
    return run if isinstance(run, Recording) else read_recording(Path(run))


def recordings_of(runs: Runs) -> list[Recording]:
    """The recordings, one or several."""
    if isinstance(runs, (Recording, str, PathLike)):
        return [recording_of(runs)]
    return [recording_of(run) for run in runs]
