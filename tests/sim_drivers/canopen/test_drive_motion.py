"""References of one drive: ramps end, profiles arrive, cyclic set-points are followed in spite of jitter."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from sim_drivers.canopen.motion import (
    EXTRAPOLATED_CYCLES,
    LAG_CYCLES,
    AxisReference,
    CyclicPosition,
    Profile,
    Standstill,
    SyncClock,
)

STEP = 1e-3


@given(st.floats(-4, 4), st.floats(0.5, 50))
def test_a_ramp_stands_after_the_way_that_physics_says(velocity: float, deceleration: float) -> None:
    motion = Standstill(AxisReference(1.0, velocity), deceleration)
    reference = AxisReference(1.0, velocity)
    for _ in range(int(abs(velocity) / deceleration / STEP) + 2):
        reference = motion.step(STEP)
        assert abs(reference.velocity) <= abs(velocity) + 1e-12
    assert motion.finished
    assert reference.velocity == 0.0
    assert reference.position == pytest.approx(1.0 + velocity * abs(velocity) / (2 * deceleration), abs=1e-9)


@settings(max_examples=40)
@given(st.floats(-6, 6), st.floats(-2, 2), st.floats(0.3, 3), st.floats(0.5, 40), st.floats(0.5, 40))
def test_a_profile_arrives_within_its_limits(
    target: float, velocity: float, speed: float, acceleration: float, deceleration: float
) -> None:
    assume(abs(velocity) <= speed)
    motion = Profile(AxisReference(0.0, velocity), target, speed, acceleration, deceleration)
    before, reference = velocity, AxisReference(0.0, velocity)
    largest = max(acceleration, deceleration) * STEP
    for _ in range(200_000):
        if motion.finished:
            break
        reference = motion.step(STEP)
        assert abs(reference.velocity) <= speed + 1e-9
        if not motion.finished:
            assert abs(reference.velocity - before) <= largest + 1e-9
        before = reference.velocity
    assert motion.finished
    assert reference.position == target


def test_a_profile_from_rest_does_not_overshoot() -> None:
    motion = Profile(AxisReference(0.0), 1.0, 2.0, 8.0, 8.0)
    while not motion.finished:
        assert motion.step(STEP).position <= 1.0 + 1e-6


def follow(jitter: float = 0.0, pause: float = 0.0, left_out: int = 0, cycle: float = 0.0025) -> tuple[float, float]:
    """Largest error against the set-points two cycles late, and largest step of velocity, after half a second.

    SYNC number 600 comes `pause` [s] late; from there, so many are left out.
    """
    generator = np.random.default_rng(4)
    clock, motion = SyncClock(), CyclicPosition(AxisReference(0.0), 0.0)

    def setpoint(time: float) -> float:
        return 0.3 * (1.0 - math.cos(2.0 * math.pi * time))

    number, due, errors, kicks, before = 0, 0.0, [], [], 0.0
    for tick in range(1, 3000):
        time = tick * STEP
        while due <= time:
            smoothed = clock.tick(due)
            motion.aim(setpoint(number * cycle), smoothed, clock.cycle)
            number += 1 + (left_out if number == 600 else 0)
            due = number * cycle + generator.uniform(0, jitter) + (pause if number == 600 else 0.0)
        reference = motion.step(STEP)
        if time > 0.5:
            errors.append(abs(reference.position - setpoint(time - LAG_CYCLES * cycle)))
            kicks.append(abs(reference.velocity - before))
        before = reference.velocity
    return max(errors), max(kicks)


EVEN = 0.0119
"""Step of velocity in 1 ms at 11.8 rad/s², the largest acceleration of that motion."""


@pytest.mark.parametrize("cycle", [0.001, 0.0025, 0.004, 0.0033])
def test_cyclic_set_points_are_followed_smoothly(cycle: float) -> None:
    error, kick = follow(cycle=cycle)
    assert error < 4e-5  # the curve cuts corners by a sixth of the second difference
    assert kick < EVEN


def test_jitter_of_sync_does_not_become_a_jitter_of_the_arm() -> None:
    error, kick = follow(jitter=2e-4)
    assert error < 5e-4
    assert kick < 1.1 * EVEN


def test_a_sync_that_is_late_once_does_not_stop_the_arm() -> None:
    error, kick = follow(pause=0.0015)
    assert error < 1e-3
    assert kick < 0.05
    error, kick = follow(pause=0.004)  # later than the next one: taken for it
    assert error < 6e-3
    assert kick < 0.1


@pytest.mark.parametrize("left_out", range(1, EXTRAPOLATED_CYCLES + 1))
def test_set_points_left_out_are_bridged(left_out: int) -> None:
    error, kick = follow(left_out=left_out)
    assert error < 8e-5 * (left_out + 1) ** 2  # what the acceleration does meanwhile
    assert kick < 3.1 * EVEN * left_out  # going on without acceleration is made up for by thrice as much


@pytest.mark.parametrize("left_out", [EXTRAPOLATED_CYCLES + 1, 10, 20])
def test_after_a_longer_pause_the_arm_is_not_thrown(left_out: int) -> None:
    error, kick = follow(left_out=left_out)
    assert error < 0.02 * left_out / 4
    assert kick < 7 * EVEN


def test_another_rate_is_found_without_a_pause() -> None:
    clock, time = SyncClock(), 0.0
    for cycle in (0.0025, 0.004, 0.001):
        for _ in range(400):
            time += cycle
            smoothed = clock.tick(time)
        assert clock.cycle == pytest.approx(cycle, rel=1e-4)
        assert smoothed == pytest.approx(time, abs=1e-5)


@given(st.lists(st.floats(0.0, 0.5), min_size=60, max_size=60), st.sets(st.integers(20, 50), max_size=10))
def test_the_drives_clock_counts_syncs_left_out(late: list[float], gone: set[int]) -> None:
    cycle = 0.0025
    clock = SyncClock(cycle)
    for number in range(60):
        if number not in gone:
            smoothed = clock.tick((number + late[number]) * cycle)
            assert abs(smoothed / cycle - number) <= 1.0


def test_without_set_points_the_motion_goes_on_for_some_cycles_and_comes_to_rest() -> None:
    clock, motion = SyncClock(), CyclicPosition(AxisReference(0.0), 0.0)
    for number in range(100):
        smoothed = clock.tick(number * 0.002)
        motion.aim(0.001 * number, smoothed, clock.cycle)
        for _ in range(2):
            motion.step(STEP)
    speeds = []
    for _ in range(100):
        reference = motion.step(STEP)
        speeds.append(reference.velocity)
    assert motion.finished
    assert np.all(np.diff(speeds) <= 1e-12)
    assert max(-np.diff(speeds)) < 25.0 * STEP  # no sudden stop
    assert 0.099 + 0.003 < reference.position < 0.099 + 0.003 + 0.5**2 / 40 + 0.001
    assert clock.cycle == pytest.approx(0.002)
    assert clock.age(1.0) == pytest.approx(1.0 - 99 * 0.002)
