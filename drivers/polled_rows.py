"""Rows of devices that are asked again and again at a rate, by a thread of its own: buffer, losses, late readings."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from drivers.base import Level, Notice
from drivers.core.arrays import FloatArray
from drivers.core.clock import Clock
from drivers.core.errors import DynidError
from drivers.streams import Batch

BUFFERED = 100_000
"""Rows that wait for `take` before the oldest is dropped."""
UNSURE = 2.0
"""Periods that a reading may last; when the devices measured is not known well enough after more."""
NOTED_AGAIN = 10.0
"""[s] between two notices on answers that are missing."""


class PolledRows(ABC):
    """Reads all devices of a connection at a rate [Hz]; `start` and `stop` begin and end its thread.

    `take` hands out and removes the commands that were `sent`, (when [s, host's monotonic clock], (n,) position [rad]),
    and beside each the gains of the loop that follows it, quantity → (n,).

    Attributes:
        latest: (n,) newest position [rad]; None before the first row.
        last_row: when it came [s, host's monotonic clock].
        asked: when the devices were asked last [s, host's monotonic clock].
        answered: id → when the device answered last.
        besides: what came in the last reading beside answers, in words.
        failure: what ended the thread; None while it runs.
        notices: what the devices reported, oldest first.
    """

    def __init__(
        self,
        name: str,
        rate: float,
        sent: deque[tuple[float, FloatArray]],
        clock: Clock,
        gains: Mapping[str, FloatArray] = MappingProxyType({}),
    ) -> None:
        self._clock, self._period, self._sent, self._gains = clock, 1.0 / rate, sent, gains
        self._changed = clock.condition()
        self._ending = clock.event()
        self._thread = clock.thread(self._run, name)
        self._rows: deque[tuple[float, float, Mapping[str, Sequence[float]]]] = deque(maxlen=BUFFERED)
        self._silent: Counter[str] = Counter()
        self._faults: dict[int, int] = {}
        self._lost = self._late = self._awaited = 0
        self._answering = 0.0
        self._noted = -np.inf
        self.notices: deque[Notice] = deque()
        self.latest: FloatArray | None = None
        self.last_row = self.asked = clock.now()
        self.answered: dict[int, float] = {}
        self.besides = ""
        self.failure: DynidError | None = None

    @abstractmethod
    def _read(self) -> None:
        """One reading: `_add` a row, or `_lose` it."""

    def start(self) -> None:
        """Begin to read."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread."""
        self._ending.set()
        with self._changed:
            self._changed.notify_all()
        self._thread.join(1.0)

    def take(self, timeout: float) -> list[Batch]:
        """Rows and commands since the last call, waiting at most `timeout` [s] for the first row.

        Raises:
            DynidError: what ended the thread, once its rows are taken.
        """
        with self._changed:
            due = self._clock.now() + timeout
            self._changed.wait_for(lambda: self._rows or self.failure is not None, timeout)
            self._clock.late(due)
            rows = [self._rows.popleft() for _ in range(len(self._rows))]
            lost, self._lost = (self._lost, 0) if rows else (0, self._lost)
        if not rows and self.failure is not None:
            raise self.failure
        rows_batch, batches = [], []
        if rows:
            stamps, received = np.array([row[0] for row in rows]), np.array([row[1] for row in rows])
            values = {name: np.array([row[2][name] for row in rows]) for name in rows[0][2]}
            rows_batch = [Batch("joints", stamps, received, values, lost)]
        if commands := [self._sent.popleft() for _ in range(len(self._sent))]:
            stamps = np.array([moment for moment, _ in commands])
            goals = np.array([goal for _, goal in commands])
            gains = {name: np.tile(values, (len(goals), 1)) for name, values in self._gains.items()}
            batches.append(Batch("commands", stamps, stamps.copy(), {"target_position": goals, **gains}))
        return batches + rows_batch  # goals before the rows that they explain

    def losses(self) -> str:
        """Return why rows were lost, in words; empty where none were."""
        said = [f"{name} did not answer {count} times" for name, count in self._silent.items()]
        if self._late:
            said.append(f"{self._late} while this computer was late to ask, or to look")
        if self._awaited:
            said.append(f"{self._awaited} while answers took longer than a period to come")
        return "; ".join(said)

    def _run(self) -> None:
        due = self._clock.now()
        try:
            while not self._ending.is_set():
                begun = self.asked = self._clock.now()
                self._read()
                lasted = self._clock.now() - due
                due += self._period
                if (behind := self._clock.now() - due) > 0.0:
                    skipped = int(behind / self._period)  # what would have been read meanwhile is lost
                    due += skipped * self._period
                    if skipped:
                        theirs = self._answering - self._clock.stalled(begun) > 0.5 * lasted
                        with self._changed:
                            self._lost += skipped
                            self._awaited += skipped if theirs else 0
                            self._late += 0 if theirs else skipped
                due = self._pause(due)
        except DynidError as error:
            with self._changed:
                self.failure = error
                self._changed.notify_all()

    def _pause(self, due: float) -> float:
        """Wait until the next reading is due [s]; when that is."""
        now = self._clock.now()
        self._ending.wait(due - now)  # also where it is due already: others want the bus
        self._clock.late(max(due, now))
        return due

    def _add(self, time: float, received: float, row: Mapping[str, Sequence[float]]) -> None:
        self._answering = 2.0 * (received - time)
        self.latest = np.array(row["position"])
        self.last_row = received
        with self._changed:
            if self._answering > UNSURE * self._period:
                self._lost += 1
                ours = self._clock.stalled(received - self._answering) > 0.5 * self._answering
                self._late += ours
                self._awaited += not ours
                return
            self._rows.append((time, received, row))
            self._changed.notify_all()

    def _lose(self, missing: Sequence[str], received: float) -> None:
        """A row without the answers of some devices."""
        self._silent.update(missing)
        self._answering = np.inf
        with self._changed:
            self._lost += 1
        if received - self._noted > NOTED_AGAIN:
            self._noted = received
            self._tell("warning", f"no answer of {', '.join(missing)}{self.besides and f', {self.besides}'}")

    def _report_fault(self, name: str, words: Sequence[str], *, moving: bool) -> None:
        """Tell which fault a device reports; without words, that it reports none any more."""
        if not words:
            self._tell("info", f"{name} no longer reports a fault")
            return
        said = f"{name} reports {', '.join(words)}"
        self._tell("error" if moving else "warning", said, "let it cool down; check its supply, its load and contacts")

    def _tell(self, level: Level, message: str, hint: str = "") -> None:
        self.notices.append(Notice(self._clock.now(), level, message, hint))
