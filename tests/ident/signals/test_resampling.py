"""Irregular stamps, gaps, and a delay between two signals."""

from __future__ import annotations

import numpy as np
import pytest
from each import each
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.errors import DataError
from ident.signals.resampling import (
    check_stamps,
    gap_free_segments,
    measure_irregularity,
    resample,
    shift_torque,
    shiftable,
    spread_stamps,
    uniform_grid,
)


def jittered(samples: int, period: float, spread: float, seed: int = 0) -> np.ndarray:
    periods = period * (1 + spread * np.random.default_rng(seed).uniform(-1, 1, samples - 1))
    return np.concatenate([[5.0], 5.0 + np.cumsum(periods)])


def test_regular_stamps_are_recognised() -> None:
    found = measure_irregularity(1e9 + np.arange(1000) / 125)
    assert found.regular
    assert (found.gaps, found.duplicates) == (0, 0)
    assert found.rate == pytest.approx(125, rel=1e-5)


def test_a_clock_that_runs_fast_is_regular() -> None:
    found = measure_irregularity(np.arange(100_000) * 0.002 * 1.0003)
    assert found.regular


def test_irregularity_is_measured() -> None:
    time = jittered(5000, 0.001, 0.3)
    found = measure_irregularity(time)
    assert not found.regular
    assert found.shortest == pytest.approx(np.diff(time).min())
    assert found.longest == pytest.approx(np.diff(time).max())
    assert found.rms_deviation == pytest.approx(0.3e-3 / np.sqrt(3), rel=0.05)
    assert found.median_period == pytest.approx(1e-3, rel=0.02)


def test_one_lost_sample_is_irregular_and_no_gap() -> None:
    found = measure_irregularity(np.delete(np.arange(1000) * 0.002, 500))
    assert not found.regular
    assert found.gaps == 0
    assert found.longest == pytest.approx(0.004)


@each(("period", "hole", "gaps"), [(0.001, 0.049, 0), (0.001, 0.051, 1), (0.01, 0.09, 0), (0.01, 0.11, 1)])
def test_gaps_are_longer_than_ten_periods_and_fifty_ms(period: float, hole: float, gaps: int) -> None:
    time = np.arange(400) * period
    time[200:] += hole - period
    assert measure_irregularity(time).gaps == gaps
    parts = gap_free_segments(time, period)
    assert [(part.start, part.stop) for part in parts] == ([(0, 200), (200, 400)] if gaps else [(0, 400)])


def test_repeated_stamps_are_counted() -> None:
    found = measure_irregularity(np.repeat(np.arange(100) * 0.01, 2))
    assert found.duplicates == 100
    assert found.regular


@pytest.mark.parametrize("share", [0.01, 0.1, 0.3])
def test_repeated_stamps_that_the_clock_makes_up_for_are_spread(share: float) -> None:
    even = np.arange(2000) * 0.002
    late = np.random.default_rng(3).random(2000) < share
    late[:1] = late[-1:] = False
    assert spread_stamps(np.where(late, np.roll(even, 1), even)) == pytest.approx(even, abs=1e-12)
    coarse = np.floor(even / 0.016 + 1e-9) * 0.016
    assert np.all(np.diff(spread_stamps(coarse))[:-8] > 0.0)
    twice = np.insert(even, 700, even[699])  # recorded twice: nothing makes up for it
    assert np.array_equal(spread_stamps(twice), twice)


def test_bad_stamps_are_named() -> None:
    time = np.arange(50) * 0.01
    time[30] = 0.1
    with pytest.raises(DataError, match="backwards") as error:
        check_stamps(time)
    assert error.value.where == "sample 30"
    time[20] = np.nan
    with pytest.raises(DataError) as error:
        check_stamps(time)
    assert error.value.where == "sample 20"
    with pytest.raises(DataError):
        measure_irregularity(np.full(10, 3.0))


@given(st.floats(0.5, 5000), st.integers(1, 2000), st.floats(-1e3, 1e6))
def test_grid_ends_with_the_last_sample(rate: float, samples: int, start: float) -> None:
    grid = uniform_grid(start, start + (samples - 1) / rate, rate)
    assert len(grid) in (samples, samples - 1)  # at 1e6 s and 5 kHz, rounding of the stamps may cost the last one
    assert grid[-1] <= start + (samples - 1) / rate + 1e-5 / rate + 1e-9
    if abs(start) < 1e3 and rate < 1000:
        assert len(grid) == samples


def test_resampling_beats_taking_the_stamps_as_uniform() -> None:
    time = jittered(4000, 0.001, 0.4)
    frequency = 2 * np.pi * 3
    rows = np.stack([np.sin(frequency * time), np.cos(frequency * time)])
    grid = uniform_grid(time[0], time[-1], measure_irregularity(time).rate)
    new = resample(time, rows, grid)
    truth = np.stack([np.sin(frequency * grid), np.cos(frequency * grid)])
    error = np.abs(new - truth).max()
    assert error < 1e-7
    common = min(len(grid), len(time))
    assert np.abs(rows[:, :common] - truth[:, :common]).max() > 1e3 * error


def test_resampling_is_exact_for_cubics_and_at_the_samples() -> None:
    time = jittered(60, 0.1, 0.4)
    grid = uniform_grid(time[0], time[-1], 17.0)
    np.testing.assert_allclose(resample(time, (time - 6)[None] ** 3, grid), (grid - 6)[None] ** 3, atol=1e-10)
    rows = np.random.default_rng(0).standard_normal((2, 60))
    np.testing.assert_allclose(resample(time, rows, time), rows, atol=1e-12)


def test_resampling_of_three_samples() -> None:
    np.testing.assert_allclose(resample(np.array([0.0, 1, 3]), np.array([[0.0, 2, 0]]), np.array([0.5, 2])), [[1, 1]])


@given(st.floats(-0.05, 0.05), st.sampled_from([125.0, 500.0, 1000.0]))
def test_shift_of_a_sinusoid(delay: float, rate: float) -> None:
    time = np.arange(300) / rate
    frequency = 2 * np.pi * 2
    torque = np.stack([np.sin(frequency * time), 3 * np.cos(frequency * time)])
    shifted = shift_torque(torque, rate, delay)
    kept = shiftable(300, rate, delay)
    truth = np.stack([np.sin(frequency * (time + delay)), 3 * np.cos(frequency * (time + delay))])
    assert shifted.shape == torque.shape
    bound = 3 * (frequency / rate) ** 4 * 0.03 + 1e-9 * rate
    assert np.abs(shifted - truth)[:, kept].max() < bound
    assert kept.stop - kept.start >= 300 - int(abs(delay) * rate) - 4


def test_shift_by_whole_samples_is_exact_and_holds_the_end() -> None:
    torque = np.arange(10.0)[None]
    np.testing.assert_array_equal(shift_torque(torque, 100, 0.03)[0], [3, 4, 5, 6, 7, 8, 9, 9, 9, 9])
    assert shiftable(10, 100, 0.03) == slice(0, 7)
    np.testing.assert_array_equal(shift_torque(torque, 100, -0.02)[0], [0, 0, 0, 1, 2, 3, 4, 5, 6, 7])
    assert shiftable(10, 100, -0.02) == slice(2, 10)
    assert shiftable(10, 100, 0.0) == slice(0, 10)
    assert shiftable(10, 100, 0.4) == slice(0, 0)


@given(st.floats(-0.3, 0.3))
def test_shiftable_columns_use_measured_samples_only(delay: float) -> None:
    torque = np.random.default_rng(0).standard_normal((1, 30))
    kept = shiftable(30, 50, delay)
    inside = shift_torque(torque, 50, delay)[:, kept]
    padded = np.concatenate([np.full((1, 40), np.nan), torque, np.full((1, 40), np.nan)], axis=1)
    np.testing.assert_allclose(shift_torque(padded, 50, delay)[:, 40:70][:, kept], inside)
