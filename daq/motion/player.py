"""The player: sends a motion to a driver, one position per period, by absolute times, in a thread of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from daq.motion.trajectories import Motion
from drivers.clock import SYSTEM_CLOCK, Clock, set_timer_slack
from drivers.errors import DynidError, WorkError
from drivers.streams import FloatArray

SKIP_LIMIT = 3
"""Overdue positions that are skipped; where a stall left more, the motion goes on where it was, that much later.

An arm that was held for 0.1 s and then receives the position of that moment jumps there.
"""
DRY_RUN = 0.3
"""Length of the dry run [s]."""
DRY_RUN_PERIODS = 5
"""Median lateness in the dry run, in periods, from which this computer is too slow for the rate."""


@dataclass(frozen=True)
class Punctuality:
    """How late positions were sent.

    Attributes:
        sent: number of positions.
        skipped: positions that were not sent since a later one was already due.
        delayed_ms: how much later the motion ended because it was resumed where it had stalled [ms].
        p50_ms, p99_ms, max_ms: lateness [ms].
    """

    sent: int
    skipped: int
    delayed_ms: float
    p50_ms: float
    p99_ms: float
    max_ms: float


def ticks(motion: Motion, rate: float) -> FloatArray:
    """Positions (N, n) of a motion at every period, both ends included."""
    count = int(np.ceil(motion.duration * rate - 1e-9)) + 1
    position, _, _ = motion.evaluate(np.minimum(np.arange(count) / rate, motion.duration))
    return np.ascontiguousarray(position.T)


class Player:
    """Sends positions until it is stopped; holds the last one when the motion is over.

    Args:
        send: takes a position (n,); a driver's `command`.
        noted: called with every position and the host's monotonic time [s], before it is sent.
        positions: (N, n), the first one where the arm stands.
        rate: [Hz].
        motion_index: of the position at which the approach ends and the motion itself begins.
        clock: the host's.
    """

    def __init__(
        self,
        send: Callable[[FloatArray], None],
        noted: Callable[[float, FloatArray], None],
        positions: FloatArray,
        rate: float,
        motion_index: int = 0,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        self.motion_index = motion_index
        self._send = send
        self._noted = noted
        self._clock = clock
        self._positions = positions
        self._period = 1.0 / rate
        self._halt = clock.event()
        self._done = False
        self._failure: DynidError | None = None
        self._late: list[float] = []
        self._skipped = 0
        self._delayed = 0.0
        self._index = 0
        self._thread = clock.thread(self._run, "player")

    @property
    def done(self) -> bool:
        """Whether the last position was sent."""
        return self._done

    @property
    def index(self) -> int:
        """Of the position sent last."""
        return self._index

    @property
    def elapsed(self) -> float:
        """How far it is in its positions [s]."""
        return self._index * self._period

    @property
    def duration(self) -> float:
        """Of all positions [s]."""
        return (len(self._positions) - 1) * self._period

    @property
    def failure(self) -> DynidError | None:
        """Why it ended before its end; None while all is well."""
        return self._failure

    def start(self) -> None:
        """Begin to send."""
        self._thread.start()

    def stop(self, timeout: float) -> bool:
        """Send no further position; whether the thread has ended within `timeout` [s]."""
        self._halt.set()
        if self._thread.ident is not None:
            self._thread.join(timeout)
        return not self._thread.is_alive()

    def punctuality(self) -> Punctuality:
        """The figures so far."""
        return _punctuality(self._late, self._skipped, self._delayed)

    def _run(self) -> None:
        set_timer_slack()
        try:
            # Taking control of an arm may last seconds: the clock starts when it is had.
            self._noted(self._clock.now(), self._positions[0])
            self._send(self._positions[0])
            start, tick, last = self._clock.now(), 0, len(self._positions) - 1
            while not self._halt.is_set():
                overdue = int((self._clock.now() - start) / self._period) - tick
                if overdue > SKIP_LIMIT and tick < last:
                    start += (overdue - 1) * self._period
                    self._delayed += (overdue - 1) * self._period
                due = max(tick + 1, int((self._clock.now() - start) / self._period))
                if tick < last:
                    self._skipped += min(due, last) - tick - 1
                tick = due
                late = self._clock.sleep_until(start + tick * self._period)
                if self._halt.is_set():
                    return
                index = min(tick, last)
                self._noted(self._clock.now(), self._positions[index])
                self._send(self._positions[index])
                self._index = index
                if tick <= last:
                    self._late.append(late)
                if index == last:
                    self._done = True
        except DynidError as error:
            self._failure = error
        except Exception as error:  # whatever it was, the session must know of it and stop the arm
            self._failure = WorkError(f"the player broke: {type(error).__name__}: {error}")


def dry_run(rate: float, clock: Clock = SYSTEM_CLOCK) -> Punctuality:
    """How punctual this computer is at a rate [Hz], without sending anything.

    Raises:
        WorkError: the median lateness is above five periods: it cannot play a motion at this rate.
    """
    set_timer_slack()
    period, late = 1.0 / rate, []
    start = clock.now()
    for tick in range(1, max(2, int(DRY_RUN * rate))):
        late.append(clock.sleep_until(start + tick * period))
    figures = _punctuality(late, 0, 0.0)
    if figures.p50_ms > 1e3 * DRY_RUN_PERIODS * period:
        raise WorkError(
            f"this computer is {figures.p50_ms:.1f} ms late at {rate:g} Hz (median of a dry run)",
            hint="end other programs, or lower the connection's rate",
        )
    return figures


def _punctuality(late: list[float], skipped: int, delayed: float) -> Punctuality:
    if not late:
        return Punctuality(0, skipped, 1e3 * delayed, float("nan"), float("nan"), float("nan"))
    p50, p99 = np.percentile(late, [50.0, 99.0])
    return Punctuality(len(late), skipped, 1e3 * delayed, 1e3 * float(p50), 1e3 * float(p99), 1e3 * max(late))
