"""Who watches a session beside its supervisor: an observer of contacts, which may stop a motion.

What it needs of the arm's dynamics is not daq's: a command hands an implementation to the session.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from drivers.streams import Batch, StreamLayout


class Watch(Protocol):
    """Watches every batch; no method may block."""

    def begin(self, layouts: Sequence[StreamLayout]) -> None:
        """Prepare for the streams of an opened driver.

        Raises:
            DynidError: it cannot watch them.
        """

    def add(self, batch: Batch) -> None:
        """Note a batch; never raises."""

    def events(self) -> Sequence[tuple[float, str]]:
        """Return what was noticed since the last call: when [s, clock of the joints' stream], and what in words."""

    def stop_reason(self) -> str:
        """Return why a motion must not go on, in words; empty where it may."""

    def lines(self) -> Sequence[str]:
        """Return its state for a display."""
