"""A Fourier series with a polynomial: its derivatives, its rest, how its periods meet, and the polynomial itself."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from daq.motion.fourier_quintic import FourierQuintic
from daq.motion.limits import motion_extremes
from daq.motion.trajectories import FourierSeries


def make(seed, period=6.0, joints=3, harmonics=4, periods=1):
    generator = np.random.default_rng(seed)
    coefficients = generator.normal(size=(2, joints, harmonics))
    return FourierQuintic(period, generator.normal(size=joints), *coefficients, periods)


@given(st.integers(0, 1000), st.floats(0.1, 100.0), st.integers(1, 6), st.integers(1, 4))
def test_every_period_begins_and_ends_at_rest_in_one_place(seed, period, harmonics, periods):
    motion = make(seed, period, harmonics=harmonics, periods=periods)
    assert motion.duration == pytest.approx(periods * period)
    ends = np.arange(periods + 1) * period
    for side in (-1e-12 * period, 0.0, 1e-12 * period):
        position, velocity, acceleration = motion.evaluate(ends + side)
        size = np.abs(motion.sine).sum() + np.abs(motion.cosine).sum()
        np.testing.assert_allclose(position, position[:, :1] * np.ones(len(ends)), atol=1e-9 * size * period)
        np.testing.assert_allclose(velocity, 0.0, atol=1e-9 * size)
        np.testing.assert_allclose(acceleration, 0.0, atol=1e-7 * size / period)


def test_velocity_and_acceleration_are_the_derivatives():
    motion, step = make(1), 1e-5
    time = np.linspace(0.01, 5.99, 500)
    _, velocity, acceleration = motion.evaluate(time)
    before, after = motion.evaluate(time - step), motion.evaluate(time + step)
    np.testing.assert_allclose((after[0] - before[0]) / (2 * step), velocity, atol=1e-7)
    np.testing.assert_allclose((after[1] - before[1]) / (2 * step), acceleration, atol=1e-7)


def test_what_is_added_to_the_series_is_the_polynomial_that_the_ends_ask_for():
    motion = make(2)
    series = FourierSeries(motion.period, motion.offset, motion.sine, motion.cosine)
    time = np.linspace(0.0, motion.period, 50, endpoint=False)
    added = motion.evaluate(time)[0] - series.evaluate(time)[0]
    # Six coefficients from six conditions, solved without the closed form.
    length = motion.period
    at_0 = [[1, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0], [0, 0, 2, 0, 0, 0]]
    powers = np.arange(6)
    at_end = [
        length**powers,
        powers * length ** np.maximum(powers - 1, 0),
        powers * (powers - 1) * length ** np.maximum(powers - 2, 0),
    ]
    _, velocity, acceleration = series.evaluate(np.zeros(1))
    ends = np.concatenate([0 * velocity, -velocity, -acceleration], axis=1)
    coefficients = np.linalg.solve(np.array([*at_0, *at_end], dtype=float), np.concatenate([ends, ends], axis=1).T)
    np.testing.assert_allclose(added, (time[:, None] ** powers @ coefficients).T, atol=1e-10)


def test_periods_repeat_and_before_and_after_it_rests():
    once, thrice = make(3), make(3, periods=3)
    time = np.linspace(0.0, once.duration, 200, endpoint=False)
    for number in range(3):
        for one, other in zip(once.evaluate(time), thrice.evaluate(time + number * once.duration), strict=True):
            np.testing.assert_allclose(one, other, atol=1e-11)
    position, velocity, acceleration = thrice.evaluate(np.array([-1.0, 0.0, thrice.duration, 100.0]))
    np.testing.assert_allclose(position, position[:, :1] * np.ones(4), atol=1e-12)
    assert np.abs(velocity).max() < 1e-12
    assert np.abs(acceleration).max() < 1e-11


def test_the_grid_finds_the_extremes():
    motion = make(4, period=4.0)
    extremes = motion_extremes(motion)
    _, velocity, acceleration = motion.evaluate(np.linspace(0.0, motion.duration, 1_000_001))
    np.testing.assert_allclose(extremes.velocity, np.abs(velocity).max(axis=1), rtol=1e-5)
    np.testing.assert_allclose(extremes.acceleration, np.abs(acceleration).max(axis=1), rtol=1e-5)
