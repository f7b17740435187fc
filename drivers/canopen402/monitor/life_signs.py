"""What drives hear from dynid while it lives: its heartbeat, or the requests of node guarding (CiA 301, 7.2.8.3.2)."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Sequence

from drivers.can.bus import REMOTE, Sender
from drivers.canopen402.protocol.objects import HEARTBEAT, STATE_OPERATIONAL
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.errors import ConnectionLostError


class LifeSigns:
    """A thread that sends one of some frames after the other, as long as this process runs.

    Args:
        sender: of the bus.
        frames: identifier and data of each.
        interval: between two frames [s].
        before: called with the number of a frame and the time [s, host's monotonic clock] before it is sent.
        clock: the host's.
    """

    def __init__(
        self,
        sender: Sender,
        frames: Sequence[tuple[int, bytes]],
        interval: float,
        before: Callable[[int, float], None] | None = None,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        self._sender, self._frames, self._interval, self._before = sender, tuple(frames), interval, before
        self._clock = clock
        self._ending = clock.event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Begin, with the first frame at once."""
        self._thread = self._clock.thread(self._run, "life signs")
        self._thread.start()

    def stop(self) -> None:
        """Send no more; safe at any time."""
        self._ending.set()
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.join()

    def _run(self) -> None:
        due, turn = self._clock.now(), 0
        while not self._ending.wait(max(0.0, due - self._clock.now())):
            if self._before is not None:
                self._before(turn, self._clock.now())
            identifier, data = self._frames[turn]
            # An adapter that is gone shows elsewhere; one that is back must find the drives still cared for.
            with contextlib.suppress(ConnectionLostError):
                self._sender.send(identifier, data)
            turn = (turn + 1) % len(self._frames)
            due = max(due + self._interval, self._clock.now())  # after a stall no burst, and no drive is left out


def heartbeat(sender: Sender, own_id: int, period: float, clock: Clock = SYSTEM_CLOCK) -> LifeSigns:
    """Dynid's heartbeat, as that of a node with an id of its own, once a period [s]."""
    return LifeSigns(sender, [(HEARTBEAT + own_id, bytes([STATE_OPERATIONAL]))], period, clock=clock)


def guard_requests(
    sender: Sender,
    ids: Sequence[int],
    period: float,
    before: Callable[[int, float], None],
    clock: Clock = SYSTEM_CLOCK,
) -> LifeSigns:
    """A remote frame to each node once a period [s], evenly spread; `before` gets its index."""
    frames = [(HEARTBEAT + node | REMOTE, bytes(1)) for node in ids]
    return LifeSigns(sender, frames, period / len(frames), before, clock)
