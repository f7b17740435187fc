"""Who keeps the samples of a session: a recorder, or none, where they are only watched."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Protocol

from daq.recording.recording import Level
from drivers.core.errors import DiskError
from drivers.streams import Batch


class SampleKeeper(Protocol):
    """Takes what a session hears and says; `daq.recording.recorder.Recorder` writes it."""

    file: Path  # that is being written
    overflow: int  # samples that were dropped because the disk did not keep up

    @property
    def backlog(self) -> int:
        """Bytes that wait for the disk."""

    @property
    def failure(self) -> DiskError | None:
        """Return what ended the writing."""

    def put(self, batch: Batch) -> None:
        """Take a batch; never blocks."""

    def event(self, time: float, level: Level, source: str, message: str) -> None:
        """Take an event at a time of the joints' stream [s]."""

    def close(self, *, complete: bool) -> None:
        """Write the rest and close.

        Raises:
            DynidError: it could not be written.
        """

    def discard(self) -> None:
        """Keep nothing of it."""


class Unrecorded:
    """Keeps nothing; a `SampleKeeper`."""

    def __init__(self) -> None:
        self.file = Path(os.devnull)
        self.overflow = self.backlog = 0
        self.failure: DiskError | None = None

    def put(self, batch: Batch) -> None:
        """Keep nothing."""

    def event(self, time: float, level: Level, source: str, message: str) -> None:
        """Keep nothing."""

    def close(self, *, complete: bool) -> None:
        """There is nothing to close."""

    def discard(self) -> None:
        """There is nothing to remove."""
