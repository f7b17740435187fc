"""Arguments of a task: one or several recordings, read already or by path; limits, by key or in a file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from daq.recording.reader import read_recording
from daq.recording.recording import Recording
from ident.verdict.acceptance import AcceptanceLimits, declared, read_limits

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


def paths_of(*given: object) -> list[Path]:
    """The paths among arguments of a task, and in lists of them; recordings that were read already have none."""
    flat = [one for part in given for one in (part if isinstance(part, (list, tuple)) else [part])]
    return [Path(one) for one in flat if isinstance(one, (str, PathLike))]


Limits = Mapping[str, Any] | str | PathLike[str]
"""Limits by their keys (docs/identification.md), or the path of a YAML file with them."""


def limits_of(accept: Limits) -> AcceptanceLimits:
    """The limits, read where a path is given.

    Raises:
        UsageError: the file cannot be read, or a key is wrong.
    """
    return declared(accept, "accept") if isinstance(accept, Mapping) else read_limits(Path(accept))
