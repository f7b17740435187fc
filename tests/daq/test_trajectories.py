"""Fourier series: velocity and acceleration are the derivatives, the period is the period."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daq.trajectories import FourierSeries


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
