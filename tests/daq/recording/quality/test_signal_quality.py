"""Noise, steps and clipping are read from signals that were made with them."""

from __future__ import annotations

import numpy as np
import pytest
from each import each
from hypothesis import given
from hypothesis import strategies as st

from daq.recording.quality.quantisation import quantisation_step
from daq.recording.quality.signal_quality import channel_quality, white_noise
from daq.recording.recording import Channel

TIME = np.arange(5000) / 500.0


@pytest.mark.parametrize("deviation", [0.01, 0.3])
def test_noise_of_a_moving_signal(deviation):
    noisy = 5.0 * np.sin(2.0 * TIME) + deviation * np.random.default_rng(0).standard_normal(len(TIME))
    assert white_noise(noisy) == pytest.approx(deviation, rel=0.1)


@each("step", [1e-5, 0.01, 0.125])
def test_step_of_a_quantised_signal(step):
    quantised = np.round(20 * step * np.sin(TIME) / step) * step
    assert quantisation_step(quantised) == pytest.approx(step, rel=1e-6)


def test_a_continuous_signal_has_no_step():
    assert np.isnan(quantisation_step(np.random.default_rng(0).standard_normal(3000)))
    assert np.isnan(quantisation_step(np.ones(100)))


def test_clipping_is_found_and_a_turning_point_is_none():
    signal = 2.0 * np.sin(TIME)
    channel = Channel("current", np.column_stack([signal, np.clip(signal, -1.5, 1.5)]), "A", ("free", "clipped"))
    free, clipped = channel_quality(channel, TIME)
    assert free.clipped_percent == 0.0
    expected = 100.0 * np.mean(np.abs(signal) >= 1.5)
    assert clipped.clipped_percent == pytest.approx(expected, abs=0.1)


@each("counts", [1.5, 3.0, 6.0, 12.0])
def test_a_coarse_signal_is_neither_clipped_nor_filled_with_zeros(counts):
    noise = 0.1 * np.random.default_rng(1).standard_normal(len(TIME))
    coarse = np.round(counts * np.sin(3.0 * TIME) + noise) * 0.0113
    cut = np.clip(coarse, -0.5 * counts * 0.0113, 0.5 * counts * 0.0113)
    sound, clipped = channel_quality(Channel("torque", np.column_stack([coarse, cut]), "N·m", ("j", "k")), TIME)
    assert sound.filled_percent == 0.0
    assert sound.clipped_percent == 0.0
    assert counts < 6.0 or clipped.clipped_percent > 50.0


@given(st.lists(st.floats(allow_nan=True, allow_infinity=True, width=32), max_size=30))
def test_no_signal_crashes(values):
    channel = Channel("x", np.array(values, dtype=np.float64).reshape(-1, 1), "A", ("j",))
    (quality,) = channel_quality(channel, 0.002 * np.arange(len(values)))
    assert quality.name == "j"
