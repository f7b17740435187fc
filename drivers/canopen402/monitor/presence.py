"""Tells whether the drives are still there: their heartbeats, or node guarding (CiA 301, 7.2.8.3.2)."""

from __future__ import annotations

import math
import threading

from drivers.canopen402.protocol.objects import GUARDING_TOGGLE, STATE_BOOT_UP
from drivers.canopen402.settings import HEARTBEATS_MISSED
from drivers.core.text import counted

_STATE = 0x7F


class Heartbeats:
    """Drives that send their heartbeat by themselves, once a period [s]; they go by their index.

    Attributes:
        limit: how long [s] a drive may be silent, about.
        back: what there is to say of a drive that is heard again.
    """

    back = "its heartbeat is back"

    def __init__(self, count: int, period: float) -> None:
        self._last = [math.nan] * count
        self.limit = HEARTBEATS_MISSED * period

    def start(self, now: float) -> None:
        """Heartbeats are due from `now` [s, host's monotonic clock] on."""
        self._last = [now] * len(self._last)

    def take(self, index: int, content: int, arrived: float) -> None:
        """A heartbeat, or a boot-up message, whose first byte is `content`; arrival [s, host's monotonic clock]."""
        del content
        self._last[index] = arrived

    def missing(self, index: int, drained: float) -> str:
        """Return why a drive counts as gone, in words; empty where it does not.

        All that arrived before `drained` [s, host's monotonic clock] has been taken.
        """
        age = drained - self._last[index]
        return f"no heartbeat for {age:.2f} s" if age > self.limit else ""


class NodeGuarding:
    """Drives that are asked for their state once a period [s], and answer with a bit that alternates.

    An answer whose bit does not alternate counts as none, as the standard has it: one that is lost makes the next one
    invalid, too. So many requests in a row as `factor` may stay without a valid answer.

    Attributes:
        limit, back: as those of `Heartbeats`.
    """

    back = "it answers node guarding again"

    def __init__(self, count: int, period: float, factor: int) -> None:
        self._count, self._period, self._factor = count, period, factor
        self.limit = period * factor
        self._lock = threading.Lock()
        self.start(0.0)

    def start(self, now: float) -> None:
        """Forget what was asked and answered."""
        del now
        with self._lock:
            self._unanswered: list[list[float]] = [[] for _ in range(self._count)]
            self._toggle: list[int | None] = [None] * self._count
            self._invalid = [0] * self._count

    def ask(self, index: int, time: float) -> None:
        """A drive is about to be asked at a time [s, host's monotonic clock]."""
        with self._lock:
            self._unanswered[index] = [*self._unanswered[index], time][: self._factor]

    def take(self, index: int, content: int, arrived: float) -> None:
        """An answer, or a boot-up message."""
        del arrived
        with self._lock:
            if content & _STATE == STATE_BOOT_UP:
                self._toggle[index] = None
                return
            if content & GUARDING_TOGGLE == self._toggle[index]:
                self._invalid[index] += 1
                return
            self._toggle[index] = content & GUARDING_TOGGLE
            self._unanswered[index] = []
            self._invalid[index] = 0

    def missing(self, index: int, drained: float) -> str:
        """Return why a drive counts as gone; empty where it does not."""
        with self._lock:
            overdue = sum(asked <= drained - self._period for asked in self._unanswered[index])
            invalid = self._invalid[index]
        if overdue < self._factor:
            return ""
        if invalid:
            answers = counted(invalid, "answer(s) to node guarding in a row")
            return f"{answers} without a toggle bit that alternates (is another master guarding it?)"
        return f"no answer to {self._factor} requests of node guarding"


Presence = Heartbeats | NodeGuarding
"""What drives say of themselves in frames of the identifier 0x700 + node id."""
