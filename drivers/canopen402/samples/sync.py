"""The SYNC producer: a thread that sends SYNC, and after it the drives' targets, on a fixed schedule."""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import TypeVar

from drivers.base import drained
from drivers.can.bus import Sender
from drivers.canopen402.protocol.objects import SYNC
from drivers.core.arrays import FloatArray
from drivers.core.clock import SYSTEM_CLOCK, BackgroundWork, Clock, set_timer_slack
from drivers.core.errors import ConnectionLostError

SILENT_PERIODS = 3
"""Without a SYNC for so many periods, and for `PATIENCE`, the adapter counts as lost."""


LATEST = 0.5
"""Share of a period: in motion, a SYNC that would come later is left out, or the next one would come too soon."""
BEHIND = 0.2
"""How late [s] a SYNC may be sent at rest, where the moment of a sample does not matter."""
SPACING = 0.75
"""Share of a period: at rest, overdue SYNCs follow each other no sooner, so that the bus can carry the answers."""
TARGET_ROOM = 0.35
"""Share of a period: targets need so long on the bus before the SYNC that applies them."""
PATIENCE = 0.1
"""How long [s] an adapter may refuse frames before it counts as lost."""

_Time = TypeVar("_Time", float, FloatArray)


class SyncProducer(BackgroundWork):
    """Sends SYNC number k at start + k/rate; no lateness accumulates.

    In motion no period is made up for. At rest, where this computer was late, SYNCs follow faster until they are on
    schedule again.

    The number of a SYNC over the rate is the clock of the samples: it starts with the first `start` and goes on through
    stops.

    Args:
        sender: of the bus.
        rate: [Hz].
        outputs: called once a period in this thread with the moment of the SYNC in the schedule [s, host's monotonic
            clock] and 0; the frames to send after the SYNC. Where SYNCs were left out, the moment is that of the last
            of these, and instead of 0 it gets how many.
        clock: the host's.
        at_rest: whether the arm is at rest, and no motion is played; called in this thread.
    """

    def __init__(
        self,
        sender: Sender,
        rate: float,
        outputs: Callable[[float, int], Sequence[tuple[int, bytes]]],
        clock: Clock = SYSTEM_CLOCK,
        at_rest: Callable[[], bool] = lambda: False,
    ) -> None:
        super().__init__("SYNC", clock)
        self.skipped = 0
        """SYNCs that were not sent, since this computer was late or the adapter refused them."""
        self.count = 0
        """SYNCs that were sent."""
        self.latest = -math.inf
        """When the newest SYNC was sent [s, host's monotonic clock]."""
        self._sender = sender
        self._rate = rate
        self._outputs = outputs
        self._at_rest = at_rest
        self._begin = math.nan
        self._sent: deque[tuple[int, float]] = deque()
        self.failure: ConnectionLostError | None = None
        """Why no SYNC is sent any more; None while all is well."""
        self._refused_since: float | None = None

    @property
    def running(self) -> bool:
        """Return whether SYNCs are being sent."""
        thread = self._thread
        return thread is not None and thread.is_alive()

    def clock(self, host_time: _Time) -> _Time:
        """A host's monotonic time [s], a number or an array, in the clock of the samples [s]."""
        return host_time - self._begin

    def start(self) -> None:
        """Begin to send."""
        if math.isnan(self._begin):
            self._begin = self._clock.now()
        self._sent.clear()
        self.failure = self._refused_since = None
        super().start()

    def take(self) -> list[tuple[int, float]]:
        """Slot and time [s, host's monotonic clock] of the SYNCs sent since the last call."""
        return drained(self._sent)

    def _run(self) -> None:
        set_timer_slack()
        slot = self._following()
        while not self._ending.is_set():
            due = self._begin + slot / self._rate
            late = self._clock.sleep_until(due)
            if self._ending.is_set():
                return
            resting = self._at_rest()
            if late > (BEHIND if resting else LATEST / self._rate):
                following = self._following(BEHIND) if resting else self._renewed(self._following(), slot)
                self.skipped += following - slot
                slot = following
                continue
            if resting:
                self._clock.sleep_until(self.latest + SPACING / self._rate)
            try:
                self.latest = self._sender.send(SYNC, b"")
            except ConnectionLostError as error:
                self.skipped += 1
                self._note_refusal(error)
            else:
                self.count += 1
                self._sent.append((slot, self.latest))
                self._send_outputs(due)
            if self.failure is not None:
                return
            slot += 1

    def _send_outputs(self, moment: float) -> None:
        try:
            self._sender.send_all(self._outputs(moment, 0))
            self._refused_since = None
        except ConnectionLostError as error:
            self._note_refusal(error)

    def _note_refusal(self, error: ConnectionLostError) -> None:
        now = self._clock.now()
        self._refused_since = self._refused_since or now
        if now - self._refused_since > PATIENCE:
            self.failure = error

    def _renewed(self, slot: int, due: int) -> int:
        """Send targets for the SYNC of a slot, those from `due` on having been left out; the slot, or a later one.

        The drives still hold targets for the SYNC that was left out. The next one must not apply them, so that one
        which is too near is left out as well.
        """
        with contextlib.suppress(ConnectionLostError):
            targets = self._outputs(self._begin + (slot - 1) / self._rate, slot - due)
            if targets and self._begin + slot / self._rate - self._clock.now() < TARGET_ROOM / self._rate:
                slot = max(slot + 1, self._following())
                targets = self._outputs(self._begin + (slot - 1) / self._rate, slot - due)
            self._sender.send_all(targets)
        return slot

    def _following(self, ago: float = 0.0) -> int:
        """The first slot that is still to come, or was `ago` [s]."""
        return math.floor((self._clock.now() - ago - self._begin) * self._rate) + 1


class KernelSync(SyncProducer):
    """Lets the kernel send SYNC, hears each one back with its time, and sends the drives' targets after it.

    Targets that would come too shortly before the next SYNC are left out: some drives would apply them with it, others
    would not.

    Args:
        sender: of a bus whose kernel driver sends periodically.
        rate: [Hz].
        outputs: called once a period with the moment of the SYNC [s, host's monotonic clock] and 0; the frames to send.
        drained: all that arrived before this time [s, host's monotonic clock] has been passed on.
        clock: the host's.
        at_rest: see `SyncProducer`, which sends where the kernel cannot.
    """

    def __init__(
        self,
        sender: Sender,
        rate: float,
        outputs: Callable[[float, int], Sequence[tuple[int, bytes]]],
        drained: Callable[[], float],
        clock: Clock = SYSTEM_CLOCK,
        at_rest: Callable[[], bool] = lambda: False,
    ) -> None:
        super().__init__(sender, rate, outputs, clock, at_rest)
        self._drained = drained
        self._heard = clock.condition()
        self._slot: int | None = None
        self._unanswered: float | None = None

    def start(self) -> None:
        """Begin to send."""
        self._slot = self._unanswered = None
        self.latest = self._clock.now()
        super().start()

    def stop(self) -> None:
        """Send no more; safe at any time."""
        with self._heard:
            self._ending.set()
            self._heard.notify_all()
        super().stop()

    def on_sync(self, identifier: int, data: bytearray, arrived: float) -> None:
        """Take a SYNC that was sent at a time [s, host's monotonic clock]; called by the receiving thread."""
        del identifier, data
        with self._heard:
            if not self.running:
                return
            if self._slot is None:  # the kernel's timer decides where the periods begin
                self._slot = math.floor((arrived - self._begin) * self._rate) + 1
                self._begin = arrived - self._slot / self._rate
            else:
                passed = max(1, round((arrived - self.latest) * self._rate))
                self.skipped += passed - 1
                self._slot += passed
            self.latest = self._unanswered = arrived
            self.count += 1
            self._sent.append((self._slot, arrived))
            self._heard.notify_all()

    def _run(self) -> None:
        set_timer_slack()
        limit = max(PATIENCE, SILENT_PERIODS / self._rate)
        try:
            task = self._sender.send_periodically(SYNC, b"", 1.0 / self._rate)
        except ConnectionLostError:  # a kernel without can-bcm; an adapter that is gone fails in the thread as well
            super()._run()
            return
        try:
            while not self._ending.is_set():
                moment = self._next_sync(PATIENCE)
                if moment is None:
                    if self._drained() - self.latest > limit:
                        self.failure = ConnectionLostError(
                            f"the CAN adapter has sent no SYNC for {limit:.2g} s",
                            hint="is another device on the bus, at this bit rate, and the bus terminated?",
                        )
                        return
                elif self._clock.now() - moment < (1.0 - TARGET_ROOM) / self._rate:
                    self._send_outputs(moment)
                if self.failure is not None:
                    return
        finally:
            task.stop()

    def _next_sync(self, timeout: float) -> float | None:
        with self._heard:
            self._heard.wait_for(lambda: self._unanswered is not None or self._ending.is_set(), timeout)
            moment, self._unanswered = self._unanswered, None
            return moment
