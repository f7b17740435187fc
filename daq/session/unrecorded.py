"""Who keeps the samples of a session: a recorder, or none, where they are only watched."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from daq.recording.recording import Level
from drivers.core.errors import DiskError
from drivers.streams import Batch

if TYPE_CHECKING:
    from daq.recording.recorder import Recorder


class Unrecorded:
    """Keeps nothing of what a session hears and says, in a recorder's place."""

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


SampleKeeper: TypeAlias = "Recorder | Unrecorded"
"""Takes what a session hears and says."""
