"""Spikes and glitches are found and replaced; velocity reversals, steps and quantisation are none."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st

from daq.recording.quality.outliers import OUTLIER_DISTANCE, TOO_MANY, without_outliers

RATE = 500.0
TIME = np.arange(5000) / RATE
RESOLUTION = 1e-5


def moving(seed: int) -> np.ndarray:
    """A quantised position (N, 1)."""
    generator = np.random.default_rng(seed)
    position = sum(generator.normal(0, 0.5) * np.sin(w * TIME + generator.uniform(0, 6)) for w in (0.6, 1.3, 2.4, 4.0))
    return np.round(position / RESOLUTION)[:, None] * RESOLUTION


def glitched(signal: np.ndarray, size: float, places: np.ndarray, length: int = 1) -> np.ndarray:
    spoilt = signal.copy()
    for place in places:
        spoilt[place : place + length] += size
    return spoilt


@pytest.mark.parametrize("length", [1, 2, 3])
@pytest.mark.parametrize("size", [0.05, -0.05, 1e-3, 6.28])
def test_glitches_of_a_moving_joint_are_found_and_replaced(size, length):
    signal = moving(1)
    places = np.arange(40, 4950, 171)
    clean = without_outliers(TIME, glitched(signal, size, places, length))
    assert clean.replaced.tolist() == [len(places) * length]
    assert np.max(np.abs(clean.values - signal)) < 4 * RESOLUTION


@settings(max_examples=50)
@given(seed=st.integers(0, 10_000), place=st.integers(10, 4980), size=st.floats(0.002, 100.0))
def test_one_glitch_anywhere_is_found_alone(seed, place, size):
    signal = moving(seed)
    clean = without_outliers(TIME, glitched(signal, size, [place]))
    assert np.flatnonzero(clean.values != glitched(signal, size, [place])).tolist() == [place]
    assert abs(clean.values[place, 0] - signal[place, 0]) < 4 * RESOLUTION


@settings(max_examples=50)
@given(
    seed=st.integers(0, 10_000),
    acceleration=st.floats(1.0, 1e4),
    rate=st.sampled_from([50.0, 125.0, 1000.0]),
    rest=st.booleans(),
)
def test_hard_reversals_are_no_outliers(seed, acceleration, rate, rest):
    generator = np.random.default_rng(seed)
    time = np.arange(4000) / rate
    holds = np.repeat(generator.choice([-1.0, 0.0, 1.0], 80), 50)
    velocity = np.cumsum(np.clip(np.diff(2.0 * holds, prepend=0.0), -acceleration / rate, acceleration / rate))
    position = np.cumsum(velocity * (0.0 if rest else 1.0) + holds) / rate
    position = np.round(position / RESOLUTION) * RESOLUTION
    friction = 8.0 * np.sign(holds) + generator.normal(0.0, 0.3, len(time))
    clean = without_outliers(time, np.column_stack([position, holds, friction]))
    assert clean.replaced.tolist() == clean.left.tolist() == [0, 0, 0]


@each("seed", range(20))
def test_noise_has_no_outliers(seed):
    generator = np.random.default_rng(seed)
    bursts = np.where(np.sin(TIME) > 0.9, 5.0, 1.0) * generator.standard_normal(len(TIME))
    heavy = generator.standard_t(8, len(TIME))
    still = np.zeros(len(TIME))
    blinking = (generator.random(len(TIME)) < 0.01) * 1e-5  # the last digit of an encoder at rest
    clean = without_outliers(TIME, np.column_stack([bursts, heavy, still, blinking]))
    assert clean.replaced.tolist() == [0, 0, 0, 0]


def test_uneven_stamps_are_no_outliers_but_glitches_among_them_are():
    generator = np.random.default_rng(3)
    true = np.cumsum(generator.choice([0.7e-3, 1e-3, 1.3e-3], 5000))
    stamps = np.sort(true + 2e-4 * generator.random(5000))
    signal = np.sin(2.0 * true)[:, None]
    assert without_outliers(stamps, signal).replaced.tolist() == [0]
    assert without_outliers(stamps, glitched(signal, 0.05, [700, 2000])).replaced.tolist() == [2]


def test_too_many_stay():
    signal = moving(4)
    places = np.arange(20, 4980, int(0.5 / TOO_MANY))
    spoilt = glitched(signal, 0.05, places)
    clean = without_outliers(TIME, spoilt)
    assert clean.replaced.tolist() == [0]
    assert clean.left[0] > TOO_MANY * len(TIME)
    assert np.array_equal(clean.values, spoilt)


def test_a_spike_of_a_noisy_signal():
    noise = np.random.default_rng(5).standard_normal((5000, 1))
    places = np.arange(40, 4950, 500)
    recorded = glitched(noise, 2.0 * OUTLIER_DISTANCE, places)
    clean = without_outliers(TIME, recorded)
    assert np.flatnonzero(clean.values[:, 0] != recorded[:, 0]).tolist() == places.tolist()


@given(
    st.lists(st.floats(allow_nan=True, allow_infinity=True, width=32), max_size=60),
    st.lists(st.floats(0.0, 1e6, width=32), min_size=60, max_size=60),
)
def test_no_signal_crashes(values, stamps):
    time = np.sort(np.array(stamps[: len(values)], dtype=np.float64))
    clean = without_outliers(time, np.array(values, dtype=np.float64).reshape(-1, 1))
    assert clean.values.shape == (len(values), 1)


ABSURD = st.sampled_from([0.0, -0.0, 1e308, -1e308, 1e-300, 5e-324, 1e256, 1e12, np.nan, np.inf, -np.inf])


@settings(max_examples=50)
@given(
    stamps=st.dictionaries(st.integers(0, 199), ABSURD, max_size=20),
    values=st.dictionaries(st.integers(0, 199), ABSURD, max_size=5),
    factor=st.sampled_from([1.0, 1e-12, 1e-300, 1e12, 0.0, -1.0]),
)
def test_absurd_stamps_and_values_give_no_warning(stamps: dict, values: dict, factor: float) -> None:
    time = np.arange(200) * 0.01 * factor
    signal = np.sin(np.arange(200) * 0.05)[:, None] * np.ones(2)
    signal[100, 0] += 0.5
    time[list(stamps)], signal[list(values), 1] = list(stamps.values()), list(values.values())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        clean = without_outliers(time, signal)
    assert clean.values.shape == signal.shape
    if factor == 1.0 and not stamps:
        assert clean.replaced[0] == 1
