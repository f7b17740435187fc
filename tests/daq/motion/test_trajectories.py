"""Fourier series: velocity and acceleration are the derivatives, the period is the period."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st

from daq.motion.limits import motion_extremes
from daq.motion.trajectories import FourierSeries, PointToPoint, RestToRest, SampledMotion, SumOfSines, slow_move
from daq.robot.schema import JointLimits


def series(seed: int, joints: int, harmonics: int, period: float) -> FourierSeries:
    generator = np.random.default_rng(seed)
    return FourierSeries(
        period,
        generator.standard_normal(joints),
        generator.standard_normal((joints, harmonics)),
        generator.standard_normal((joints, harmonics)),
    )


SERIES = st.builds(
    series, st.integers(0, 1000), st.integers(1, 7), st.integers(1, 6), st.floats(0.5, 60.0, allow_nan=False)
)


@settings(deadline=None, max_examples=50)
@given(SERIES)
def test_derivatives_are_derivatives(motion):
    time = np.linspace(0.0, motion.period, 50)
    step = 1e-5 * motion.period
    _, velocity, acceleration = motion.evaluate(time)
    before, after = motion.evaluate(time - step), motion.evaluate(time + step)
    assert np.allclose((after[0] - before[0]) / (2 * step), velocity, rtol=0, atol=1e-5 * np.max(np.abs(velocity)))
    scale = np.max(np.abs(acceleration))
    assert np.allclose((after[1] - before[1]) / (2 * step), acceleration, rtol=0, atol=1e-5 * scale)


@settings(deadline=None, max_examples=50)
@given(SERIES, st.integers(1, 5))
def test_it_repeats_after_its_period_and_its_mean_is_the_offset(motion, periods):
    time = np.linspace(0.0, motion.period, 64, endpoint=False)
    for now, later in zip(motion.evaluate(time), motion.evaluate(time + periods * motion.period), strict=True):
        assert now.shape == (len(motion.offset), 64)
        assert np.allclose(now, later, rtol=0, atol=1e-9 * (1 + np.max(np.abs(now))))
    position, velocity, acceleration = motion.evaluate(time)
    assert np.allclose(position.mean(axis=1), motion.offset, atol=1e-9 * (1 + np.max(np.abs(position))))
    assert np.allclose(velocity.mean(axis=1), 0.0, atol=1e-9)
    assert np.allclose(acceleration.mean(axis=1), 0.0, atol=1e-9 * (1 + np.max(np.abs(acceleration))))


def test_one_harmonic_is_the_papers_formula():
    motion = FourierSeries(2.0, np.array([0.3]), np.array([[0.5]]), np.array([[0.2]]))
    time, omega = np.array([0.0, 0.1, 0.7]), np.pi
    position, velocity, acceleration = motion.evaluate(time)
    expected = 0.3 + 0.5 / omega * np.sin(omega * time) - 0.2 / omega * np.cos(omega * time)  # ROCR6 eq. 21
    assert position[0] == pytest.approx(expected)
    assert velocity[0] == pytest.approx(0.5 * np.cos(omega * time) + 0.2 * np.sin(omega * time))
    assert acceleration[0] == pytest.approx(omega * (0.2 * np.cos(omega * time) - 0.5 * np.sin(omega * time)))


@settings(deadline=None, max_examples=50)
@given(SERIES)
def test_amplitudes_of_position_give_the_formula_without_the_division(motion):
    harmonics = 2.0 * np.pi / motion.period * np.arange(1, motion.sine.shape[1] + 1)
    same = FourierSeries.from_position_amplitudes(
        motion.period, motion.offset, motion.sine / harmonics, -motion.cosine / harmonics
    )
    time = np.linspace(0.0, motion.period, 20)
    for one, other in zip(motion.evaluate(time), same.evaluate(time), strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-9 * (1 + np.max(np.abs(one))))


def test_position_amplitudes_are_the_papers_formula():
    motion = FourierSeries.from_position_amplitudes(2.0, np.array([0.3]), np.array([[0.5]]), np.array([[0.2]]))
    time, omega = np.array([0.0, 0.1, 0.7]), np.pi
    expected = 0.3 + 0.5 * np.sin(omega * time) + 0.2 * np.cos(omega * time)  # AUBO eq. 20
    assert motion.evaluate(time)[0][0] == pytest.approx(expected)


def samples(seed: int) -> SampledMotion:
    generator = np.random.default_rng(seed)
    return SampledMotion(np.cumsum([0.0, *generator.uniform(0.2, 1.0, 7)]), generator.standard_normal((3, 8)))


POINTS = PointToPoint(np.array([[0.0, 1.0], [2.0, -1.0], [1.0, 0.0]]), np.array([1.0, 2.0]), 0.5)
SINES = SumOfSines(3.0, np.array([0.1]), np.array([[0.3, 0.2]]), np.array([[2.0, 5.5]]))
MOTIONS = [POINTS, SINES, samples(1), RestToRest(SINES, 1, 0.7), RestToRest(series(1, 3, 4, 2.0), 3, 1.0)]


@each("motion", MOTIONS)
def test_every_motion_has_its_own_derivatives(motion):
    step = 1e-5
    # clear of the joints between polynomials, where the third derivative jumps
    time = np.linspace(0.01, motion.duration - 0.01, 397)
    before, _, after = (motion.evaluate(time + shift) for shift in (-step, 0.0, step))
    _, velocity, acceleration = motion.evaluate(time)
    assert np.allclose((after[0] - before[0]) / (2 * step), velocity, rtol=0, atol=1e-6 * np.max(np.abs(velocity)))
    scale = np.max(np.abs(acceleration))
    assert np.allclose((after[1] - before[1]) / (2 * step), acceleration, rtol=0, atol=1e-3 * scale)


def test_points_are_reached_and_their_extremes_are_the_quintics():
    position, velocity, _ = POINTS.evaluate(np.array([-1.0, 0.0, 1.2, 4.0, 9.0]))
    np.testing.assert_allclose(position.T, [[0, 1], [0, 1], [2, -1], [1, 0], [1, 0]], atol=1e-12)
    np.testing.assert_allclose(velocity, 0.0, atol=1e-12)
    extremes = motion_extremes(POINTS)
    np.testing.assert_allclose(extremes.velocity, 1.875 * 2.0)
    np.testing.assert_allclose(extremes.acceleration, 10.0 / np.sqrt(3.0) * 2.0)


def test_a_ramped_series_is_the_series_in_between_and_rests_at_its_ends():
    inner = series(3, 2, 3, 2.0)
    motion = RestToRest(inner, 2, 1.0)
    time = np.linspace(0.0, 4.0, 100)
    for own, ramped in zip(inner.evaluate(time), motion.evaluate(time + 1.0), strict=True):
        np.testing.assert_allclose(own, ramped, atol=1e-9)
    for quantity in motion.evaluate(np.array([0.0, motion.duration]))[1:]:
        np.testing.assert_allclose(quantity, 0.0, atol=1e-12)


def limits(position: float, velocity: float, acceleration: float) -> list[JointLimits]:
    return [JointLimits(name="j1", position=(-position, position), velocity=velocity, acceleration=acceleration)]


@each("way", [0.0, 0.01, 3.0])
def test_a_slow_move_uses_a_share_of_the_limits(way):
    move = slow_move(np.array([0.0]), np.array([way]), limits(4, 2.0, 5.0), 0.1)
    extremes = motion_extremes(move)
    assert extremes.velocity[0] <= 0.2 * (1 + 1e-9)
    assert extremes.acceleration[0] <= 0.5 * (1 + 1e-9)
    assert move.evaluate(np.array([move.duration]))[0][0, 0] == way


@pytest.mark.parametrize("kind", ["sines", "series"])
def test_many_sines_are_evaluated_part_by_part(kind):
    generator = np.random.default_rng(1)
    first, second = generator.normal(size=(2, 2, 900))
    motion = (
        SumOfSines(9.0, np.ones(2), first, second) if kind == "sines" else FourierSeries(9.0, np.ones(2), first, second)
    )
    time = np.linspace(0.0, 9.0, 3000)
    tracemalloc.start()
    whole = motion.evaluate(time)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 40e6  # of all at once, 3 × 22 or 2 × 43 MB
    parts = [motion.evaluate(part) for part in np.array_split(time, 7)]
    for order in range(3):
        np.testing.assert_allclose(whole[order], np.hstack([part[order] for part in parts]), rtol=1e-9, atol=1e-6)
