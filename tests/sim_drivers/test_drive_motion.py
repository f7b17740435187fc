"""References of one drive: ramps end, profiles arrive, cyclic set-points are followed in spite of jitter."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from sim_drivers.drive_motion import AxisReference, CyclicPosition, Profile, Standstill, SyncClock

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


@settings(max_examples=40, deadline=None)
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


def follow(jitter: float, pause: float = 0.0) -> tuple[float, float]:
    """Largest error against the set-points one cycle late, and largest step of velocity, after half a second."""
    generator = np.random.default_rng(4)
    cycle = 0.0025
    clock, motion = SyncClock(), CyclicPosition(AxisReference(0.0), 0.0)

    def setpoint(time: float) -> float:
        return 0.3 * (1.0 - math.cos(2.0 * math.pi * time))

    number, due, errors, kicks, before = 0, 0.0, [], [], 0.0
    for tick in range(1, 3000):
        time = tick * STEP
        while due <= time:
            smoothed = clock.tick(due)
            motion.aim(setpoint(number * cycle), smoothed, clock.cycle)
            number += 1
            due = number * cycle + generator.uniform(0, jitter) + (pause if number == 600 else 0.0)
        reference = motion.step(STEP)
        if time > 0.5:
            errors.append(abs(reference.position - setpoint(time - cycle)))
            kicks.append(abs(reference.velocity - before))
        before = reference.velocity
    return max(errors), max(kicks)


def test_cyclic_set_points_are_followed_without_lag() -> None:
    error, kick = follow(jitter=0.0)
    assert error < 1e-4
    assert kick < 0.03  # two lines of 2.5 ms differ by 11.8 rad/s² · 2.5 ms


def test_jitter_of_sync_does_not_become_a_jitter_of_the_arm() -> None:
    error, kick = follow(jitter=2e-4)
    assert error < 5e-4
    assert kick < 0.03


def test_a_sync_that_is_late_once_does_not_stop_the_arm() -> None:
    error, kick = follow(jitter=0.0, pause=0.004)
    assert error < 3e-3
    assert kick < 0.1


def test_without_set_points_the_reference_comes_to_rest_at_the_last_one() -> None:
    clock, motion = SyncClock(), CyclicPosition(AxisReference(0.0), 0.0)
    for number in range(100):
        smoothed = clock.tick(number * 0.002)
        motion.aim(0.001 * number, smoothed, clock.cycle)
        for _ in range(2):
            motion.step(STEP)
    for _ in range(100):
        reference = motion.step(STEP)
    assert motion.finished
    assert reference.position == pytest.approx(0.099, abs=1e-6)
    assert clock.cycle == pytest.approx(0.002)
    assert clock.age(1.0) == pytest.approx(1.0 - 99 * 0.002)
