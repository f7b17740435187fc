"""The player: sends a motion, one position per period, by absolute times, in a thread of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from daq.motion.trajectories import Motion, quintic_pace
from drivers.core.arrays import FloatArray
from drivers.core.clock import STALL_LIMIT as STALL_LIMIT
from drivers.core.clock import SYSTEM_CLOCK, Clock, set_timer_slack
from drivers.core.errors import DynidError, SafetyStopError, WorkError

SKIP_LIMIT = 3
SKIP_TIME = 0.01
"""Overdue positions that are skipped, at most, and the time [s] that they may take beyond the first. Where a stall left
more, the arm was held meanwhile: the motion goes on from rest, where it was."""
UNHELD_STALL_LIMIT = 0.0
"""The same, beyond positions that are skipped, for an arm that is not held where commands pause."""
GENTLE = 0.25
"""Share of the acceleration limit that going on from rest may add to the path's own: its torque was planned."""
BEHIND, KEPT_UP = 0.25, 1.0
"""A motion ends where sending positions that come too late to be skipped takes more than this share of about the last
so many seconds. Until then such an arm is held, and goes on from rest: it is slow, and within its limits."""
UNHELD_KEPT_UP = 5
"""An arm that is not held where commands pause sees those at uneven times. Its motion ends where more than `BEHIND` of
about so many positions took longer than a period: the second of six."""
DRY_RUN = 0.3
"""Length of the dry run [s]."""
DRY_RUN_PERIODS = 5
"""Median lateness in the dry run, in periods, from which this computer is too slow for the rate."""
_SHORTEST_RAMP, _LONGEST_RAMP = 0.05, 6.4
"""Ramps [s] by which a motion goes on after a stall; doubled until one keeps the acceleration limit."""
_AHEAD = 128
"""Positions that are evaluated at once."""


@dataclass(frozen=True)
class Punctuality:
    """How late positions were sent."""

    sent: int  # number of positions
    skipped: int  # positions that were not sent since a later one was already due
    delayed_ms: float  # how much later the motion ended because it was resumed where it had stalled [ms]
    # p50_ms, p99_ms, max_ms: lateness [ms]
    p50_ms: float
    p99_ms: float
    max_ms: float


def skip_limit(period: float) -> int:
    """Return how many overdue positions are skipped at a period [s]."""
    return int(np.clip(SKIP_TIME / period + 1e-9, 1, SKIP_LIMIT))


class MotionSequence:
    """Motions one after the other, each from rest to rest, where the one before ends, begun at a tick of the player.

    Ticks come at a rate [Hz].
    """

    def __init__(self, motions: Sequence[Motion], rate: float) -> None:
        self._motions = tuple(motions)
        lengths = [np.ceil(motion.duration * rate - 1e-9) for motion in motions]
        self.rate = rate
        self.starts = np.concatenate([[0.0], np.cumsum(lengths)]) / rate
        """When each begins [s], and the end."""

    @property
    def duration(self) -> float:
        """[s], a whole number of periods."""
        return float(self.starts[-1])

    def evaluate(self, times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position, velocity and acceleration, each (N, n), at times (N,) [s]; at rest before and after."""
        which = np.clip(np.searchsorted(self.starts, times + 1e-12, side="right") - 1, 0, len(self._motions) - 1)
        result: list[FloatArray] | None = None
        for index in np.unique(which):
            motion, here = self._motions[index], which == index
            own = times[here] - self.starts[index]
            values = motion.evaluate(np.clip(own, 0.0, motion.duration))
            outside = (own < -1e-9) | (own > motion.duration + 1e-9)
            if result is None:
                result = [np.empty((len(times), len(values[0]))) for _ in values]
            for order, (whole, value) in enumerate(zip(result, values, strict=True)):
                whole[here] = value.T if order == 0 else np.where(outside[:, None], 0.0, value.T)
        if result is None:
            raise ValueError("no times to evaluate a path at")
        return result[0], result[1], result[2]

    def positions(self, times: FloatArray) -> FloatArray:
        """Positions (N, n) at times (N,) [s]."""
        return self.evaluate(times)[0]


@dataclass(frozen=True)
class _Course:
    """How a path's own time goes on from a tick: slowly from rest during `ramp` [s], then at full pace."""

    tick: int
    begin: float
    ramp: float

    def at(self, ticks: FloatArray, period: float) -> FloatArray:
        """The path's time [s] at ticks (N,) from `tick` on."""
        since = (ticks - self.tick) * period
        if self.ramp == 0.0:
            return np.asarray(self.begin + since)
        risen, _, _ = quintic_pace(since, self.ramp)
        return np.asarray(self.begin + risen + np.maximum(since - self.ramp, 0.0))


_NOTHING_AHEAD: tuple[int, FloatArray, FloatArray] = (0, np.empty(0), np.empty((0, 0)))
"""First tick, the path's times (N,) [s] and the positions (N, n) of what is evaluated ahead."""


class Player:
    """Sends positions until it is stopped; holds the last one when the motion is over.

    Args:
        send: takes a position (n,) and when it is due [s, host clock]; the command gate.
        path: to play; it begins where the arm stands.
        acceleration: (n,) limits [rad/s² or m/s²], kept when the motion goes on after a stall.
        clock: the host's.
        held: whether the arm comes to rest in order where commands pause; else no motion goes on after a stall.
        buffered: how late [s] a position may be sent without the arm's noticing; then none is skipped.
    """

    def __init__(
        self,
        send: Callable[[FloatArray, float], None],
        path: MotionSequence,
        acceleration: FloatArray,
        clock: Clock = SYSTEM_CLOCK,
        *,
        held: bool = True,
        buffered: float = 0.0,
    ) -> None:
        self._send = send
        self._clock = clock
        self._held, self._buffered = held, buffered
        self._path = path
        self._acceleration = acceleration
        self._period = 1.0 / path.rate
        self._halt = clock.event()
        self.done = False
        """Whether the last position was sent."""
        self.failure: DynidError | None = None
        """Why it ended before its end; None while all is well."""
        self._late: list[float] = []
        self._skipped = 0
        self.delayed = 0.0
        """How much later the motion ends since it went on from rest after stalls [s]."""
        self._behind = 0.0
        self.elapsed = 0.0
        """The path's time of the position sent last [s]."""
        self._course = _Course(0, 0.0, 0.0)
        self._ahead = _NOTHING_AHEAD
        self._thread = clock.thread(self._run, "player")

    @property
    def duration(self) -> float:
        """Duration of the path [s]."""
        return self._path.duration

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
        return _punctuality(self._late, self._skipped, self.delayed)

    def _run(self) -> None:
        set_timer_slack()
        try:
            self._play()
        except DynidError as error:
            self.failure = error
        except Exception as error:  # whatever it was, the session must know of it and stop the arm
            self.failure = WorkError(f"the player broke: {type(error).__name__}: {error}")

    def _play(self) -> None:
        start, tick, period = self._clock.now(), 0, self._period
        skipped_at_most = skip_limit(period)
        self._send(self._position(0), start)
        while not self._halt.is_set():
            late = self._clock.sleep_until(start + (tick + 1) * period)
            if self._halt.is_set():
                return
            overdue = max(int((self._clock.now() - start) / period + 1e-9) - tick - 1, 0)
            if self.done:
                start, overdue = start + overdue * period, 0  # at rest, where time does not matter
            elif self._buffered and overdue * period <= self._buffered:
                overdue = 0  # each is sent, one at once after the other
            elif overdue > skipped_at_most:
                self._go_on_from_rest(tick, overdue * period)
                start, overdue = start + overdue * period, 0
            tick += 1 + overdue
            if not self.done:
                self._skipped += overdue
                self._late.append(late)
            position = self._position(tick)
            begun = self._clock.now()
            self._send(position, start + tick * period)
            if not self._buffered:
                self._require_to_keep_up(self._clock.now() - begun)
            self.done = self.done or self.elapsed >= self._path.duration - 1e-9

    def _require_to_keep_up(self, took: float) -> None:
        """Note how long it took to send a position [s]."""
        slow = (1 + skip_limit(self._period)) * self._period if self._held else self._period
        weight = min(max(took, self._period) / KEPT_UP, 1.0) if self._held else 1.0 / UNHELD_KEPT_UP
        self._behind += (float(took > slow) - self._behind) * weight
        if self._behind > BEHIND:
            share = f"last {KEPT_UP:g} s was spent on positions that" if self._held else "last positions"
            raise SafetyStopError(
                f"the bus or this computer does not keep up: more than a quarter of the {share} took longer than "
                f"{1e3 * slow:.3g} ms to send",
                hint="lower the connection's rate (sync_rate), end other programs, or use --realtime",
            )

    def _go_on_from_rest(self, tick: int, stalled: float) -> None:
        """Let the path go on slowly from the position that was sent last, which the arm has held for `stalled` [s]."""
        if stalled > (STALL_LIMIT if self._held else UNHELD_STALL_LIMIT):
            at_most = STALL_LIMIT if self._held else self._buffered
            longer = f"more than {at_most:g} s" if at_most else "longer than this arm bridges without commands"
            raise SafetyStopError(
                f"this computer stalled for {stalled:.3f} s in the motion, {longer}",
                hint="end other programs, or use --realtime, and play the motion again",
            )
        for added in (GENTLE, 1.0):
            ramp = _SHORTEST_RAMP
            while ramp <= _LONGEST_RAMP:
                course = _Course(tick, self.elapsed, ramp)
                if self._keeps_limits(course, added):
                    self._course, self._ahead = course, _NOTHING_AHEAD
                    self.delayed += stalled + 0.5 * ramp
                    return
                ramp *= 2.0
        raise SafetyStopError(
            "after a stall of this computer the motion cannot continue within the acceleration limits",
            hint="end other programs, or use --realtime, and play the motion again",
        )

    def _keeps_limits(self, course: _Course, added: float) -> bool:
        """Whether a course keeps the acceleration limits, and adds no more than a share of them to the path's own."""
        ticks = np.arange(course.tick, course.tick + int(course.ramp / self._period) + 2, dtype=float)
        _, pace, change = quintic_pace((ticks - course.tick) * self._period, course.ramp)
        _, velocity, acceleration = self._path.evaluate(course.at(ticks, self._period))
        own, more = acceleration * pace[:, None] ** 2, velocity * change[:, None]
        wanted = np.maximum(np.abs(own + more), np.abs(more) / added)
        return bool(np.all(wanted <= self._acceleration * (1.0 + 1e-3)))

    def _position(self, tick: int) -> FloatArray:
        """The position (n,) at a tick; notes the path's time there."""
        first, times, ahead = self._ahead
        if not first <= tick < first + len(ahead):
            ticks = np.arange(tick, tick + _AHEAD, dtype=float)
            times = np.minimum(self._course.at(ticks, self._period), self._path.duration)
            first, times, ahead = self._ahead = tick, times, self._path.positions(times)
        self.elapsed = float(times[tick - first])
        return np.asarray(ahead[tick - first])


def dry_run(rate: float, clock: Clock = SYSTEM_CLOCK) -> Punctuality:
    """Return how punctual this computer is at a rate [Hz], without sending anything.

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
