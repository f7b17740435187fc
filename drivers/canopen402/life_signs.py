"""What drives hear from dynid while it lives: its heartbeat, or the requests of node guarding (CiA 301, 7.2.8.3.2)."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Sequence

from drivers.can_bus import REMOTE, Sender
from drivers.canopen402.objects import HEARTBEAT, STATE_OPERATIONAL
from drivers.errors import ConnectionLostError


class LifeSigns:
    """A thread that sends one of some frames after the other, as long as this process runs.

    Args:
        sender: of the bus.
        frames: identifier and data of each.
        interval: between two frames [s].
        before: called with the number of a frame and the time [s, host's monotonic clock] before it is sent.
    """

    def __init__(
        self,
        sender: Sender,
        frames: Sequence[tuple[int, bytes]],
        interval: float,
        before: Callable[[int, float], None] | None = None,
    ) -> None:
        self._sender, self._frames, self._interval, self._before = sender, tuple(frames), interval, before
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Begin, with the first frame at once."""
        self._thread = threading.Thread(target=self._run, name="life signs", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Send no more; safe at any time."""
        self._ending.set()
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.join()

    def _run(self) -> None:
        due, turn = time.monotonic(), 0
        while not self._ending.wait(max(0.0, due - time.monotonic())):
            if self._before is not None:
                self._before(turn, time.monotonic())
            identifier, data = self._frames[turn]
            # An adapter that is gone shows elsewhere; one that is back must find the drives still cared for.
            with contextlib.suppress(ConnectionLostError):
                self._sender.send(identifier, data)
            turn = (turn + 1) % len(self._frames)
            due = max(due + self._interval, time.monotonic())  # after a stall no burst, and nobody is left out


def heartbeat(sender: Sender, own_id: int, period: float) -> LifeSigns:
    """Dynid's heartbeat, as that of a node with an id of its own, once a period [s]."""
    return LifeSigns(sender, [(HEARTBEAT + own_id, bytes([STATE_OPERATIONAL]))], period)


def guard_requests(
    sender: Sender, ids: Sequence[int], period: float, before: Callable[[int, float], None]
) -> LifeSigns:
    """A remote frame to each node once a period [s], evenly spread; `before` is told which one, by its index."""
    frames = [(HEARTBEAT + node | REMOTE, bytes(1)) for node in ids]
    return LifeSigns(sender, frames, period / len(frames), before)
