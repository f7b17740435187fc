"""What a stream of CAN frames has to tell people: lost, doubled and short frames, faults of the arm, a wrong rate."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Sequence

import numpy as np

from drivers.base import Notice
from drivers.can.receiver import NOTICE_PERIOD
from drivers.can_signals.rows.assembly import Rows
from drivers.can_signals.table.signals import Signal
from drivers.core.arrays import FloatArray
from drivers.core.clock import SYSTEM_CLOCK, Clock

RATE_TIME = 2.0
"""How long [s] rows are counted before their rate is judged."""
RATE_TIMES = 2
"""So often in a row the rate must be wrong: a computer that stalls makes arrivals late once, not twice."""
RATE_TOLERANCE = 0.05


class Troubles:
    """Counts what went wrong, and says so at most once a second.

    Args:
        notices: are appended to.
        clock: the host's.

    Attributes:
        missing: what the last incomplete row lacked; empty where none was.
    """

    def __init__(self, notices: deque[Notice], clock: Clock = SYSTEM_CLOCK) -> None:
        self.missing = ""
        self._notices = notices
        self._clock = clock
        self._counts: dict[str, int] = {}
        self._reported = -math.inf
        self._lacked: Counter[str] = Counter()

    def forget(self) -> None:
        """Begin to count lost rows anew."""
        self._lacked.clear()

    def losses(self) -> str:
        """Frames that rows of the joints lacked since `forget`, in words."""
        return ", ".join(f"no {label}: {count} time(s)" for label, count in self._lacked.most_common())

    def note(self, rows: Rows, *, essential: bool) -> None:
        """Note what was wrong with some rows; `essential`: of the joints."""
        if rows.missing:
            self.missing = rows.missing[0].label
        if rows.incomplete and essential:
            self._lacked[self.missing or "another frame"] += rows.incomplete
        self._count("incomplete row(s)", rows.incomplete)
        self._count("frame(s) that came twice", rows.duplicates)
        self._count("frame(s) too short for the table", rows.short)
        self._report()

    def note_clock(self, repeated: int, restarted: int) -> None:
        """Note rows whose time or counter was not new, and jumps of it."""
        self._count("row(s) left out whose time or counter was not new", repeated)
        self._count("jump(s) of the arm's clock; was it restarted?", restarted)

    def _count(self, what: str, more: int) -> None:
        if more:
            self._counts[what] = self._counts.get(what, 0) + more

    def _report(self) -> None:
        now = self._clock.now()
        if not self._counts or now - self._reported < NOTICE_PERIOD:
            return
        for what, count in self._counts.items():
            lacked = f"; the last lacked {self.missing}" if what.startswith("incomplete") and self.missing else ""
            self._notices.append(Notice(math.nan, "warning", f"{count} {what}{lacked}"))
        self._counts.clear()
        self._reported = now


class FaultWatch:
    """Tells when a signal `fault` stops being 0, as an error, and when it is 0 again.

    Args:
        notices: are appended to.
    """

    def __init__(self, notices: deque[Notice]) -> None:
        self._notices = notices
        self._last: dict[str, float] = {}

    def forget(self) -> None:
        """Begin anew: what is in fault is reported again."""
        self._last.clear()

    def note(self, signals: Sequence[Signal], rows: Rows, source_minus_host: float) -> None:
        """Look at the rows of a stream; `source_minus_host` [s] takes arrivals to the source's clock."""
        for column, signal in enumerate(signals):
            if signal.quantity != "fault" or not len(rows.values):
                continue
            values = rows.values[:, column]
            changes = np.flatnonzero(np.diff(values, prepend=self._last.get(signal.joint, 0.0)))
            for row in changes:
                when = float(rows.host_time[row]) + source_minus_host
                if values[row] != 0.0:
                    self._notices.append(Notice(when, "error", f"{signal.label}: {values[row]:g}"))
                else:
                    self._notices.append(Notice(when, "info", f"{signal.label} is over"))
            self._last[signal.joint] = float(values[-1])


class RateWatch:
    """Tells once where the arm's cycles come at another rate than the robot file says.

    Args:
        notices: are appended to.
        rate: that the file says [Hz].
    """

    def __init__(self, notices: deque[Notice], rate: float) -> None:
        self._notices = notices
        self._rate = rate
        self.forget()

    def forget(self) -> None:
        """Begin anew."""
        self._begun: float | None = None
        self._count = 0
        self._wrong = 0
        self._judged = False

    def note(self, host_time: FloatArray, lost: int) -> None:
        """Rows that arrived at (N,) [s], and how many were lost with them."""
        if self._judged:
            return
        if self._begun is None:
            self._begun, self._count = float(host_time[0]), -1
        self._count += len(host_time) + lost
        elapsed = float(host_time[-1]) - self._begun
        if elapsed < RATE_TIME or self._count < RATE_TIME:
            return
        rate = self._count / elapsed
        self._begun, self._count = float(host_time[-1]), 0
        if abs(rate / self._rate - 1.0) <= RATE_TOLERANCE:
            self._judged = True
            return
        self._wrong += 1
        if self._wrong == RATE_TIMES:
            self._judged = True
            message = f"cycles come at {rate:.4g} Hz, but the robot file says {self._rate:g} Hz; correct its 'rate'"
            self._notices.append(Notice(math.nan, "warning", message))
