"""Smoothing by polynomials through neighbouring samples: Savitzky-Golay and five-point cubic."""

from __future__ import annotations

import numpy as np
import pytest
from each import each

from ident.signals.smoothing.five_point import (
    MOST_PASSES,
    five_point_cubic,
    five_point_gain,
    half_gain_frequency,
    passes_for,
)
from ident.signals.smoothing.savitzky_golay import half_width_for, savitzky_golay, savitzky_golay_gain

TIME = np.arange(60) / 50


@pytest.mark.parametrize("passes", [1, 7])
def test_five_point_leaves_a_cubic_unchanged_up_to_its_ends(passes: int) -> None:
    rows = np.stack([1 + TIME - 2 * TIME**2 + TIME**3, -(TIME**3)])
    np.testing.assert_allclose(five_point_cubic(rows, passes), rows, atol=1e-12)


@each("relative", [0.03, 0.1, 0.2])
@each("passes", [1, 5])
def test_five_point_gain_of_a_sinusoid(relative: float, passes: int) -> None:
    wave = np.sin(2 * np.pi * relative * np.arange(400))[None]
    smooth = five_point_cubic(wave, passes)
    inner = slice(50, -50)
    np.testing.assert_allclose(smooth[:, inner], five_point_gain(relative, passes) * wave[:, inner], atol=1e-6)


@each("rate", [125.0, 500.0, 5000.0])
@each("cutoff", [5.0, 40.0])
def test_five_point_passes_bring_the_gain_to_one_half(rate: float, cutoff: float) -> None:
    passes = passes_for(cutoff, rate)
    assert 1 <= passes <= MOST_PASSES
    reached = half_gain_frequency(passes, rate)
    assert five_point_gain(reached / rate, passes) == pytest.approx(0.5)
    if 1 < passes < MOST_PASSES:
        assert reached == pytest.approx(cutoff, rel=0.1)


def test_savitzky_golay_is_exact_for_polynomials_of_its_degree() -> None:
    rows = (1 - TIME + TIME**4)[None]
    smooth, first, second = savitzky_golay(rows, 50.0, 6)
    np.testing.assert_allclose(smooth, rows, atol=1e-10)
    np.testing.assert_allclose(first[0], -1 + 4 * TIME**3, atol=1e-8)
    np.testing.assert_allclose(second[0], 12 * TIME**2, atol=1e-6)


@each("relative", [0.01, 0.05, 0.15])
def test_savitzky_golay_window_is_the_longest_with_half_the_gain(relative: float) -> None:
    half_width = half_width_for(relative, 1.0, 10_000)
    assert savitzky_golay_gain(relative, half_width) >= 0.5 > savitzky_golay_gain(relative, half_width + 1)
    wave = np.sin(2 * np.pi * relative * np.arange(2000))[None]
    smooth, _, _ = savitzky_golay(wave, 1.0, half_width)
    inner = slice(500, -500)
    np.testing.assert_allclose(smooth[:, inner], savitzky_golay_gain(relative, half_width) * wave[:, inner], atol=1e-9)


def test_savitzky_golay_window_fits_a_short_signal() -> None:
    half_width = half_width_for(0.001, 1.0, 16)
    assert 2 * half_width + 1 <= 16
    assert savitzky_golay(np.ones((1, 16)), 1.0, half_width)[0] == pytest.approx(1.0)
