"""Periods on the host's clock do not drift."""

from __future__ import annotations

from itertools import islice

import pytest

from sim_drivers.wall_clock import periods


class Clock:
    """A clock that sleeps too long and is worked on between two periods."""

    def __init__(self, oversleep=0.0003):
        self.now, self.oversleep = 100.0, oversleep

    def sleep(self, seconds):
        assert seconds > 0
        self.now += seconds + self.oversleep


def test_lateness_does_not_accumulate():
    clock = Clock()
    for count, late in enumerate(islice(periods(0.002, clock=lambda: clock.now, sleep=clock.sleep), 5000), start=1):
        assert clock.now == pytest.approx(100.0 + count * 0.002 + late)
        assert 0.0 <= late < 0.0004
        clock.now += 0.001


def test_a_late_consumer_catches_up_and_misses_nothing():
    clock = Clock(oversleep=0.0)
    lateness = []
    for count, late in enumerate(islice(periods(0.01, clock=lambda: clock.now, sleep=clock.sleep), 50)):
        lateness.append(late)
        clock.now += 0.1 if count == 10 else 0.002
    assert max(lateness) == pytest.approx(0.09)
    assert lateness[-1] == pytest.approx(0.0, abs=1e-9)
    assert clock.now == pytest.approx(100.0 + 50 * 0.01 + 0.002)


def test_a_sleep_that_ends_early_is_slept_again():
    clock = Clock()
    naps = periods(0.01, clock=lambda: clock.now, sleep=lambda seconds: clock.sleep(0.4 * seconds))
    assert next(naps) >= 0.0
    assert clock.now >= 100.01


def test_the_real_clock():
    assert all(late >= 0.0 for late in islice(periods(0.001), 20))


@pytest.mark.parametrize("period", [0.0, -1.0, float("nan")])
def test_a_period_must_be_positive(period):
    with pytest.raises(ValueError, match="positive"):
        next(periods(period))
