"""Motions that repeat themselves: found exactly under noise, and never where there are none."""

from __future__ import annotations

import numpy as np
import pytest
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st

from daq.motion.trajectories import RestToRest
from daq.robot.loader import load_robot
from ident.model.dynamic_model import build_model
from ident.signals.repetition import motion_phases, own_period
from sim_drivers.synthetic.measurement import random_fourier_motion


def periodic(period: int, samples: int, seed: int = 0, joints: int = 3, noise: float = 0.0, start: int = 0):
    """Velocity (n, samples) of five random harmonics."""
    generator = np.random.default_rng(seed)
    angle = 2.0 * np.pi * (start + np.arange(samples)) / period
    velocity = np.zeros((joints, samples))
    for harmonic in range(1, 6):
        sine, cosine = generator.standard_normal((2, joints, 1))
        velocity += sine * np.sin(harmonic * angle) + cosine * np.cos(harmonic * angle)
    return velocity + noise * np.random.default_rng(seed + 1000 + start).standard_normal(velocity.shape)


def aperiodic(samples: int, seed: int = 0, joints: int = 3):
    """Velocity (n, samples) of a low-passed random walk."""
    from scipy.ndimage import gaussian_filter1d

    white = np.random.default_rng(seed).standard_normal((joints, samples))
    return gaussian_filter1d(white, 8.0, axis=1, mode="constant")


@each("noise", [0.0, 0.1])
@each("period", [97, 200, 333])
@each("repetitions", [1.5, 2.0, 5.3])
def test_the_period_is_found_to_the_sample(period, repetitions, noise):
    samples = round(period * repetitions)
    assert [own_period(periodic(period, samples, seed, noise=noise)) for seed in range(3)] == [period] * 3


@pytest.mark.parametrize(("period", "periods", "ramp"), [(15.0, 2, 2.0), (5.0, 3, 2.0), (20.0, 1.5, 0.0)])
def test_ramps_into_and_out_of_the_periods_do_not_hide_them(period, periods, ramp):
    motion = random_fourier_motion(build_model(load_robot("up6")), period, seed=1, candidates=1)
    whole = RestToRest(motion, int(periods), ramp) if ramp else motion
    time = np.arange(0.0, whole.duration if ramp else periods * period, 0.05)
    velocity = whole.evaluate(time)[1]
    assert own_period(velocity) == pytest.approx(20.0 * period, abs=1)


def test_a_motion_that_does_not_repeat_has_no_period():
    assert [own_period(aperiodic(1500, seed)) for seed in range(10)] == [None] * 10


def test_a_repetition_of_less_than_a_tenth_of_the_recording_is_not_believed():
    assert own_period(periodic(300, 310)) is None


@each("value", [0.0, 1.0, -3.0])
def test_constant_velocity_has_no_period(value):
    """A constant equals itself at every lag, which is no sign of a repetition."""
    assert own_period(np.full((3, 400), value)) is None
    (phases,) = motion_phases([np.full((3, 400), value)])
    assert np.array_equal(phases, np.arange(400))


def test_a_joint_that_stands_still_does_not_hide_the_period_of_the_others():
    velocity = periodic(150, 500)
    velocity[1] = 0.0
    assert own_period(velocity) == 150


def test_a_slow_joint_counts_like_a_fast_one():
    """One joint repeats every 100 samples, a slow one only every 200: so does the arm."""
    velocity = periodic(100, 700)
    velocity[2] = 1e-3 * periodic(200, 700, seed=5)[2]
    assert own_period(velocity) == 200


def test_phases_count_up_and_start_again():
    (phases,) = motion_phases([periodic(120, 500)])
    assert np.array_equal(phases, np.arange(500) % 120)


def test_two_recordings_of_one_trajectory_share_their_numbers():
    first = periodic(200, 500, noise=0.05)
    second = periodic(200, 450, noise=0.05, start=37)
    one, other = motion_phases([first, second])
    assert np.array_equal(other, (37 + np.arange(450)) % 200)
    assert set(other) == set(one)


def test_two_recordings_of_one_aperiodic_motion_share_the_part_that_both_have():
    motion = aperiodic(1000)
    one, other = motion_phases([motion[:, :700], motion[:, 300:]])
    assert np.array_equal(other[:400], one[300:])
    assert not set(other[400:]) & set(one)
    assert len(set(other)) == 700


def test_different_motions_have_disjoint_numbers():
    phases = motion_phases([periodic(200, 500), periodic(200, 500, seed=1), aperiodic(400), aperiodic(300, seed=1)])
    for number, one in enumerate(phases):
        for other in phases[number + 1 :]:
            assert not set(one) & set(other)


def test_a_third_recording_of_the_first_motion_finds_it_again():
    phases = motion_phases([periodic(200, 500), aperiodic(400), periodic(200, 300, start=10)])
    assert np.array_equal(phases[2], (10 + np.arange(300)) % 200)


def test_a_mirrored_motion_is_another_one():
    motion = aperiodic(600)
    one, other = motion_phases([motion, -motion])
    assert not set(one) & set(other)


@settings(deadline=None, max_examples=80)
@given(
    lengths=st.lists(st.integers(0, 40), max_size=4),
    joints=st.integers(1, 3),
    seed=st.integers(0, 1000),
    scale=st.sampled_from([0.0, 1e-300, 1e-12, 1.0, 1e12]),
)
def test_any_lengths_get_numbers(lengths, joints, seed, scale):
    generator = np.random.default_rng(seed)
    velocities = [scale * generator.standard_normal((joints, length)) for length in lengths]
    phases = motion_phases(velocities)
    assert [len(phase) for phase in phases] == lengths
    assert all(np.issubdtype(phase.dtype, np.integer) and np.all(phase >= 0) for phase in phases)


@settings(deadline=None, max_examples=40)
@given(samples=st.integers(60, 300), seed=st.integers(0, 1000))
def test_a_motion_and_its_copy_are_one_motion(samples, seed):
    motion = aperiodic(samples, seed)
    one, other = motion_phases([motion, motion])
    assert np.array_equal(one, other)
