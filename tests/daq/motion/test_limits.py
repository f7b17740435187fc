"""The extremes of a motion are enclosed: no denser grid finds a value beyond, and the bounds are sharp."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st

from daq.motion.approach import TimeScaled
from daq.motion.fourier_quintic import FourierQuintic
from daq.motion.limits import check_limits, check_rest, motion_extremes
from daq.motion.trajectories import FourierSeries, Motion, PointToPoint, RestToRest, SampledMotion, SumOfSines
from daq.robot.schema import JointLimits
from drivers.core.errors import UsageError

ROUNDING = 1e-6
"""Rounding of a value far from 0 s, as a share of the largest."""


def exponents(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high).map(lambda exponent: 10.0**exponent)


def _series(kind: type, seed: int, harmonics: int, period: float, size: float, periods: int, ramp: float) -> Motion:
    generator = np.random.default_rng(seed)
    # A few harmonics alone, high ones among them: what a coarse grid misses.
    sine, cosine = size * generator.standard_normal((2, 2, harmonics)) * (generator.random((2, 2, harmonics)) < 0.5)
    if kind is FourierQuintic:
        return FourierQuintic(period, generator.standard_normal(2), sine, cosine, periods)
    return RestToRest(FourierSeries(period, generator.standard_normal(2), sine, cosine), periods, ramp)


def _sines(seed: int, count: int, duration: float, size: float, fastest: float, ramp: float) -> Motion:
    generator = np.random.default_rng(seed)
    frequency = fastest * generator.uniform(-1.0, 1.0, (2, count))
    amplitude = size * generator.standard_normal((2, count))
    return RestToRest(SumOfSines(duration, generator.standard_normal(2), amplitude, frequency), 1, ramp)


def _points(seed: int, count: int, shortest: float, size: float, dwell: float) -> Motion:
    generator = np.random.default_rng(seed)
    durations = shortest * 10.0 ** generator.uniform(0.0, 3.0, count)
    return PointToPoint(size * generator.standard_normal((count + 1, 2)), durations, dwell)


def _samples(seed: int, count: int, shortest: float, size: float) -> Motion:
    generator = np.random.default_rng(seed)
    time = np.concatenate([[0.0], np.cumsum(shortest * 10.0 ** generator.uniform(0.0, 3.0, count))])
    return SampledMotion(time, size * generator.standard_normal((2, count + 1)))


SEEDS, SIZES, RAMPS = st.integers(0, 10**6), exponents(-6, 6), exponents(-4, 1)
MOTIONS = st.one_of(
    st.builds(
        _series,
        st.sampled_from([FourierQuintic, FourierSeries]),
        SEEDS,
        st.integers(1, 60),
        exponents(-2, 3),
        SIZES,
        st.integers(1, 4),
        RAMPS,
    ),
    st.builds(_sines, SEEDS, st.integers(1, 8), exponents(-2, 2), SIZES, exponents(-2, 3), RAMPS),
    st.builds(_points, SEEDS, st.integers(1, 8), exponents(-4, 1), SIZES, exponents(-3, 1)),
    st.builds(_samples, SEEDS, st.integers(3, 20), exponents(-4, 0), SIZES),
)
SCALED = st.builds(TimeScaled, MOTIONS, st.floats(0.01, 1.0))


def looked_up(motion: Motion, generator: np.random.Generator) -> np.ndarray:
    """(4, n) largest values on a grid that is dense in every piece of the motion, and at random times."""
    pieces = motion.pieces()
    places = np.linspace(0.0, 1.0, 40_000 // len(pieces.start))
    dense = (pieces.start[:, None] + (pieces.end - pieces.start)[:, None] * places).ravel()
    time = np.concatenate([dense, generator.uniform(0.0, motion.duration, 10_000), [motion.duration]])
    position, velocity, acceleration = motion.evaluate(np.clip(time, 0.0, motion.duration))
    return np.array([(-position).max(1), position.max(1), np.abs(velocity).max(1), np.abs(acceleration).max(1)])


@settings(deadline=None, max_examples=20)
@given(MOTIONS | SCALED, SEEDS)
def test_no_value_lies_beyond_the_bounds_and_the_bounds_are_reached(motion, seed):
    extremes = motion_extremes(motion)
    size = ROUNDING * np.maximum(1.0, np.abs(extremes.found))
    assert np.all(looked_up(motion, np.random.default_rng(seed)) <= extremes.bound + size)
    assert np.all(extremes.bound >= extremes.found)
    np.testing.assert_allclose(extremes.bound, extremes.found, rtol=1e-9, atol=1e-9)
    for row, times in enumerate(extremes.times):
        position, velocity, acceleration = motion.evaluate(times)
        values = (-position, position, np.abs(velocity), np.abs(acceleration))[row].diagonal()
        np.testing.assert_allclose(values, extremes.found[row], rtol=1e-12, atol=1e-12)


@settings(deadline=None, max_examples=20)
@given(MOTIONS | SCALED, SEEDS, exponents(-3, 3))
def test_a_motion_that_is_accepted_keeps_its_limits_at_any_time(motion, seed, share):
    """Limits near the motion's own extremes, above or below."""
    generator = np.random.default_rng(seed)
    extremes = motion_extremes(motion)
    sizes = np.maximum(extremes.found[2:], 1e-6) * 10.0 ** generator.uniform(-0.3, 0.5, (2, 2)) * share
    bounds = np.maximum(np.abs(extremes.lowest), np.abs(extremes.highest)) + generator.uniform(-0.1, 1.0, 2)
    limits = [
        JointLimits.model_construct(name=f"j{j}", position=(-r, r), velocity=v, acceleration=a)
        for j, (r, v, a) in enumerate(zip(np.maximum(bounds, 1e-3), *sizes, strict=True))
    ]
    allowed = np.array(
        [(limit.position[1], limit.position[1], limit.velocity, limit.acceleration) for limit in limits]
    ).T
    seen = looked_up(motion, generator)
    try:
        check_limits(motion, limits, "test")
    except UsageError:
        assert np.any(extremes.bound > allowed)
    else:
        assert np.all(seen <= allowed + ROUNDING * np.maximum(1.0, np.abs(seen)))


@each("ramp", [1e-3, 1e-4, 1e-6])
def test_a_ramp_between_two_points_of_a_grid_is_seen(ramp):
    motion = RestToRest(FourierSeries(10.0, np.zeros(1), np.array([[0.6]]), np.array([[0.0]])), 1, ramp)
    with pytest.raises(UsageError, match=r"joint j1: acceleration 1[.0-9e+]* at 0.00"):
        check_limits(motion, limits(3.0, 3.0, 8.0), "test")
    assert motion_extremes(motion).acceleration[0] == pytest.approx(0.6 * 15.0 / 8.0 / ramp, rel=1e-3)


@pytest.mark.parametrize("frequency", [1e12, 1e30, 1e150, 1e300])
def test_a_motion_too_fast_to_be_enclosed_is_refused_by_its_bound(frequency):
    motion = SumOfSines(1.0, np.zeros(1), np.array([[1.0 / frequency]]), np.array([[frequency]]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(UsageError, match=r"joint j1: (velocity|acceleration)"):
            check_limits(motion, limits(3.0, 0.5, 8.0), "test")


def limits(position: float, velocity: float, acceleration: float) -> list[JointLimits]:
    return [JointLimits(name="j1", position=(-position, position), velocity=velocity, acceleration=acceleration)]


ONE_SINE = FourierSeries(2.0, np.array([0.0]), np.array([[1.0]]), np.array([[0.0]]))  # 1/π rad, 1 rad/s, π rad/s²


@each("quantity", ["position", "velocity", "acceleration"])
def test_limits_are_sharp(quantity):
    exact = {"position": 1.0 / np.pi, "velocity": 1.0, "acceleration": np.pi}
    check_limits(ONE_SINE, limits(**exact), "test")
    with pytest.raises(UsageError, match=f"joint j1: {quantity}"):
        check_limits(ONE_SINE, limits(**{**exact, quantity: exact[quantity] * (1 - 1e-6)}), "test")


def test_a_motion_must_rest_at_its_ends():
    with pytest.raises(UsageError, match="begins with joint j1"):
        check_rest(ONE_SINE, limits(9, 9, 9), "test")
    check_rest(RestToRest(ONE_SINE, 1, 1.0), limits(9, 9, 9), "test")
