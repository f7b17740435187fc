"""SYNC that the kernel sends by its own timer, where a busy computer does not delay it (socketcan)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from drivers.can.bus import Sender
from drivers.canopen402.protocol.objects import SYNC
from drivers.canopen402.samples.sync import PATIENCE, TARGET_ROOM, SyncProducer
from drivers.core.clock import SYSTEM_CLOCK, Clock, set_timer_slack
from drivers.core.errors import ConnectionLostError

SILENT_PERIODS = 3
"""Without a SYNC for so many periods, and for `PATIENCE`, the adapter counts as lost."""


class KernelSync(SyncProducer):
    """Lets the kernel send SYNC, hears each one back with its time, and sends the drives' targets after it.

    Targets that would come too shortly before the next SYNC are left out: some drives would apply them with it, others
    would not.

    Args:
        sender: of a bus whose kernel driver sends periodically.
        rate: [Hz].
        outputs: called once a period with the moment of the SYNC [s, host's monotonic clock]; the frames to send.
        drained: all that arrived before this time [s, host's monotonic clock] has been passed on.
        clock: the host's.
        at_rest: see `SyncProducer`, which sends where the kernel cannot.
    """

    def __init__(
        self,
        sender: Sender,
        rate: float,
        outputs: Callable[[float], Sequence[tuple[int, bytes]]],
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
        self.latest = self._host_clock.now()
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
                        self._failure = ConnectionLostError(
                            f"the CAN adapter has sent no SYNC for {limit:.2g} s",
                            hint="is another device on the bus, at this bit rate, and the bus terminated?",
                        )
                        return
                elif self._host_clock.now() - moment < (1.0 - TARGET_ROOM) / self._rate:
                    self._send_outputs(moment)
                if self._failure is not None:
                    return
        finally:
            task.stop()

    def _next_sync(self, timeout: float) -> float | None:
        with self._heard:
            self._heard.wait_for(lambda: self._unanswered is not None or self._ending.is_set(), timeout)
            moment, self._unanswered = self._unanswered, None
            return moment
