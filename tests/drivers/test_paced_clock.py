"""The clock of commands: whatever this computer's clock says, it goes no faster than the arm's; stalls are seen."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.clock import STALL_LIMIT, Clock
from drivers.core.errors import SafetyStopError
from drivers.paced_clock import HELD, JITTER, LOST, ArmTime, PacedClock

PERIOD = 0.005


class Liar(Clock):
    """True time, and what the host's clock says of it; sleeps end when that shows their end."""

    def __init__(self, says: Callable[[float], float] = lambda true: true) -> None:
        super().__init__()
        self.true, self.says, self.stalls = 0.0, says, dict[float, float]()
        self.frozen_at = np.inf

    def now(self) -> float:
        return self.says(self.true)

    def sleep(self, seconds: float) -> None:
        goal = self.now() + seconds
        while self.now() < goal - 1e-9:
            self.true += 2.5e-4
        for when in [when for when in self.stalls if when <= self.true]:
            self.true += self.stalls.pop(when)

    def arm_time(self) -> ArmTime:
        """Samples every `PERIOD`, which arrive 0.2 ms later or after a stall."""
        own = PERIOD * np.floor((min(self.true, self.frozen_at) - 2e-4) / PERIOD)
        return ArmTime(100.0 + own, self.says(own + 2e-4), PERIOD)

    def ticks(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """True times of ticks `PERIOD` apart, and how many periods each one is overdue."""
        paced, when, overdue = PacedClock(self, self.arm_time), [], []
        begun = paced.now()
        for tick in range(1, count):
            paced.sleep_until(begun + tick * PERIOD)
            when.append(self.true)
            overdue.append((paced.now() - begun) / PERIOD - tick)
        return np.array(when), np.array(overdue)


@given(st.floats(1.0, 3.0), st.floats(0.05, 0.2))
def test_a_clock_that_runs_faster_gets_ahead_by_a_sample_and_its_jitter_once(speed: float, begun: float) -> None:
    liar = Liar(lambda true: true + (speed - 1.0) * max(0.0, true - begun))
    liar.true = 0.01
    when, overdue = liar.ticks(80)
    ahead = PERIOD * np.arange(1, 80) - (when - 0.01)
    assert ahead.max() <= PERIOD + JITTER + 1e-3
    assert overdue.max() <= (PERIOD + JITTER) / PERIOD + 0.5


@given(st.floats(0.008, 5.0), st.floats(0.05, 0.1))
def test_a_clock_that_jumps_ahead_neither_skips_a_command_nor_sends_it_sooner(jump: float, begun: float) -> None:
    liar = Liar(lambda true: true + jump * (true > begun))
    liar.true = 0.01
    when, overdue = liar.ticks(40)
    assert np.diff(when).min() > 0.8 * PERIOD
    assert overdue.max() < 0.5


@given(st.floats(0.006, 0.1), st.floats(0.05, 0.1))
def test_a_stall_is_seen_as_long_as_it_was(length: float, begun: float) -> None:
    liar = Liar()
    liar.true, liar.stalls = 0.01, {begun: length}
    paced = PacedClock(liar, liar.arm_time)
    start = paced.now()
    late = [paced.sleep_until(start + tick * PERIOD) for tick in range(1, 25)]
    assert max(late) == pytest.approx(length, abs=JITTER + 1.5e-3)


def test_where_the_arms_clock_stands_nothing_more_is_due() -> None:
    liar = Liar()
    liar.true, liar.frozen_at = 0.01, 0.1
    with pytest.raises(SafetyStopError, match="clock has shown nothing new"):
        liar.ticks(100)
    assert liar.true < 0.1 + HELD + STALL_LIMIT + 3.0 * PERIOD


def test_samples_that_are_lost_hold_commands_for_a_moment_only() -> None:
    liar = Liar()
    liar.true = 0.01
    whole = liar.arm_time
    liar.arm_time = lambda: whole() if not 0.06 < liar.true < 0.09 else ArmTime(100.055, 0.0552, PERIOD)  # type: ignore[method-assign]
    when, overdue = liar.ticks(40)
    assert overdue.max() < 0.5
    assert 39 * PERIOD <= when[-1] - 0.01 + 1e-6 < 39 * PERIOD + LOST + 1e-3
