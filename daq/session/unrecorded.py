"""A session without a recording: samples are watched, and none is kept."""

from __future__ import annotations

import os
from pathlib import Path

from daq.recording.recorder import Recorder
from daq.recording.recording import Level
from drivers.streams import Batch


class Unrecorded(Recorder):
    """Takes the place of a recorder, and keeps nothing."""

    def __init__(self) -> None:
        self.path = self.file = Path(os.devnull)
        self.overflow = 0
        self._waiting = 0
        self._failure = None

    def put(self, batch: Batch) -> None:
        """Keep nothing."""

    def event(self, time: float, level: Level, source: str, message: str) -> None:
        """Keep nothing."""

    def close(self, *, complete: bool) -> None:
        """There is nothing to close."""

    def discard(self) -> None:
        """There is nothing to remove."""
