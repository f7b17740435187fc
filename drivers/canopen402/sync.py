"""The SYNC producer: a thread that sends SYNC, and after it the drives' targets, on a fixed schedule."""

from __future__ import annotations

import contextlib
import math
import threading
from collections import deque
from collections.abc import Callable, Sequence
from typing import TypeVar

from drivers.can.bus import Sender
from drivers.canopen402.objects import SYNC
from drivers.clock import SYSTEM_CLOCK, Clock, set_timer_slack
from drivers.errors import ConnectionLostError
from drivers.streams import FloatArray

LATEST = 0.5
"""Of a period: a SYNC that would come later than this is left out, or the next one would come too soon after it."""
TARGET_ROOM = 0.35
"""Of a period: targets need so long on the bus before the SYNC that applies them."""
PATIENCE = 0.1
"""How long [s] an adapter may refuse frames before it counts as lost."""

_Time = TypeVar("_Time", float, FloatArray)


class SyncProducer:
    """Sends SYNC number k at start + k/rate; no lateness accumulates, and no period is made up for.

    The number of a SYNC over the rate is the clock of the samples: it starts with the first `start` and goes on through
    stops.

    Args:
        sender: of the bus.
        rate: [Hz].
        outputs: called once a period in this thread with the moment of the SYNC in the schedule [s, host's monotonic
            clock]; the frames to send after the SYNC. Where SYNCs were left out, they are sent for the last of these.
        clock: the host's.
    """

    def __init__(
        self,
        sender: Sender,
        rate: float,
        outputs: Callable[[float], Sequence[tuple[int, bytes]]],
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        self.skipped = 0
        """SYNCs that were not sent, since this computer was late or the adapter refused them."""
        self.count = 0
        """SYNCs that were sent."""
        self.latest = -math.inf
        """When the newest SYNC was sent [s, host's monotonic clock]."""
        self._sender = sender
        self._rate = rate
        self._outputs = outputs
        self._host_clock = clock
        self._begin = math.nan
        self._sent: deque[tuple[int, float]] = deque()
        self._ending = clock.event()
        self._failure: ConnectionLostError | None = None
        self._thread: threading.Thread | None = None

    @property
    def failure(self) -> ConnectionLostError | None:
        """Why no SYNC is sent any more; None while all is well."""
        return self._failure

    @property
    def running(self) -> bool:
        """Whether SYNCs are being sent."""
        thread = self._thread
        return thread is not None and thread.is_alive()

    def clock(self, host_time: _Time) -> _Time:
        """A host's monotonic time [s], a number or an array, in the clock of the samples [s]."""
        return host_time - self._begin

    def start(self) -> None:
        """Begin to send."""
        if math.isnan(self._begin):
            self._begin = self._host_clock.now()
        self._sent.clear()
        self._failure = None
        self._ending.clear()
        self._thread = self._host_clock.thread(self._run, "SYNC")
        self._thread.start()

    def stop(self) -> None:
        """Send no more; safe at any time."""
        self._ending.set()
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.join()

    def take(self) -> list[tuple[int, float]]:
        """Slot and time [s, host's monotonic clock] of the SYNCs sent since the last call."""
        found = []
        while self._sent:
            found.append(self._sent.popleft())
        return found

    def _run(self) -> None:
        set_timer_slack()
        slot = self._next()
        refused_since: float | None = None
        while not self._ending.is_set():
            due = self._begin + slot / self._rate
            late = self._host_clock.sleep_until(due)
            if self._ending.is_set():
                return
            if late * self._rate > LATEST:
                following = self._renewed(self._next())
                self.skipped += following - slot
                slot = following
                continue
            sent = False
            try:
                self.latest = self._sender.send(SYNC, b"")
                self.count += 1
                self._sent.append((slot, self.latest))
                sent = True
                self._sender.send_all(self._outputs(due))
                refused_since = None
            except ConnectionLostError as error:
                self.skipped += not sent
                now = self._host_clock.now()
                refused_since = refused_since or now
                if now - refused_since > PATIENCE:
                    self._failure = error
                    return
            slot += 1

    def _renewed(self, slot: int) -> int:
        """Send targets for the SYNC of a slot after some left out; the slot, or a later one where that is too near.

        The drives still hold targets for the SYNC that was left out. The next one must not apply them.
        """
        with contextlib.suppress(ConnectionLostError):
            targets = self._outputs(self._begin + (slot - 1) / self._rate)
            if targets and self._begin + slot / self._rate - self._host_clock.now() < TARGET_ROOM / self._rate:
                slot = max(slot + 1, self._next())
                targets = self._outputs(self._begin + (slot - 1) / self._rate)
            self._sender.send_all(targets)
        return slot

    def _next(self) -> int:
        """The first slot that is still to come."""
        return math.floor((self._host_clock.now() - self._begin) * self._rate) + 1
