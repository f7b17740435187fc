"""Clocks of arm and computer that run at different rates: told apart from late samples, jumps and small drifts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from simulated_clock import simulated_time
from table_arm_bench import KEYS, PERIOD, POSE, ROBOT, TIME, connection_of, opened, served, session
from unchecked import unchecked_play

from daq.motion.trajectories import PointToPoint
from drivers.clock_rates import ClockRates
from drivers.core.errors import MotionRefusedError, SafetyStopError

DELAYS = st.lists(st.floats(0.0, 0.3), min_size=1, max_size=20)


@given(DELAYS, st.floats(-0.01, 0.01), st.floats(-1e6, 1e6))
def test_late_samples_and_small_drifts_are_nothing(delays: list[float], drift: float, offset: float) -> None:
    rates = ClockRates()
    for tick in range(2000):
        time = 0.01 * tick
        assert rates.add(time, offset + (1.0 + drift) * time + delays[tick % len(delays)]) == ""


@given(st.lists(st.floats(0.0, 0.003), min_size=1, max_size=20), st.sampled_from([0.2, 0.5, 2.0, 5.0]))
def test_another_rate_shows_within_seconds(delays: list[float], speed: float) -> None:
    rates = ClockRates()
    said = [rates.add(0.01 * tick, 0.01 * speed * tick + delays[tick % len(delays)]) for tick in range(300)]
    assert any(said)


@given(st.lists(st.tuples(st.integers(0, 299), st.floats(-9.0, 9.0)), max_size=5))
def test_jumps_are_nothing(jumps: list[tuple[int, float]]) -> None:
    rates = ClockRates()
    for tick in range(300):
        ahead = sum(jump for when, jump in jumps if when <= tick)
        assert rates.add(0.01 * tick + ahead, 0.01 * tick) == ""


@settings(max_examples=20)
@given(st.lists(st.tuples(st.floats(0.002, 0.3), st.floats(0.0, 1.0)), min_size=50, max_size=200))
def test_an_arm_that_stalls_and_catches_up_in_part_is_nothing(stalls: list[tuple[float, float]]) -> None:
    """A simulated arm on a computer that is busy: it stands, then goes on faster for a while."""
    rates, own, host = ClockRates(), 0.0, 0.0
    for stood, made_up in stalls:
        for _ in range(6):
            own, host = own + 0.01, host + 0.01
            assert rates.add(own, host) == ""
        host += stood
        own += made_up * stood
        assert rates.add(own, host) == ""


def test_a_computers_clock_that_is_set_back_is_said() -> None:
    rates = ClockRates()
    said = [rates.looked(0.01 * tick - 0.02 * (tick > 20)) for tick in range(40)]
    assert [tick for tick, words in enumerate(said) if words] == [21]
    assert said[21] == "this computer's clock was set back by 0.010 s"


@pytest.mark.parametrize("moving", [False, True])
def test_no_motion_is_played_by_a_clock_that_cannot_be_trusted(tmp_path: Path, moving: bool) -> None:
    table = {"signals": [TIME if signal["quantity"] == "counter" else signal for signal in KEYS["signals"]]}
    with simulated_time() as clock, served(clock, **table) as server:
        with opened(connection_of(server) | table, clock) as driver:
            going = [True]

            def run_away() -> None:
                clock.sleep(0.9 if moving else 0.0)
                while going[0]:
                    server.obey(f"clock-jump {PERIOD}")
                    clock.sleep(PERIOD)

            clock.thread(run_away, "the arm's clock").start()
            play = unchecked_play(PointToPoint(np.array([POSE, POSE + 0.2, POSE]), np.array([4.0, 4.0])), ROBOT)
            report = session(tmp_path / "run.h5", driver, clock, play)
            going[0] = False
            clock.sleep(0.1)
        assert "times the rate of this computer's" in str(report.stopped_by)
        assert isinstance(report.error, SafetyStopError | MotionRefusedError)
        assert np.abs(server._arm.arm.measure().position - POSE).max() < (0.1 if moving else 0.01)  # type: ignore[attr-defined]
