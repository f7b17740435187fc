"""Noise levels from the innovations."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ident.signals.smoothing.kalman import (
    HIGHEST_CUTOFF,
    WHITE_CURVATURE,
    WHITE_SNAP,
    kalman_smoother,
    likeliest_cutoff,
    sample_noise,
    stationary_filter,
)

RATE = 100.0


@pytest.mark.parametrize("cutoff", [2.0, 8.0])
@pytest.mark.parametrize("order", [WHITE_CURVATURE, WHITE_SNAP])
def test_noise_levels_of_the_model_are_recovered(order: int, cutoff: float) -> None:
    std, samples = 0.02, 6000
    stationary = stationary_filter(2 * math.pi * cutoff / RATE, order)
    generator = np.random.default_rng(order)
    shape = np.linalg.cholesky(stationary.process + 1e-18 * np.eye(order))
    state, measured = np.zeros(order), np.empty(samples)
    for index in range(samples):
        state = stationary.transition @ state + shape @ generator.standard_normal(order)
        measured[index] = std * (state[0] + generator.standard_normal())
    found = likeliest_cutoff(measured, RATE, order, 0.2)
    assert found == pytest.approx(cutoff, rel=0.15)
    assert sample_noise(measured, RATE, order, found) == pytest.approx(std, rel=0.05)


@pytest.mark.parametrize("std", [1e-5, 1e-3])
def test_sample_noise_of_a_smooth_motion(std: float) -> None:
    time = np.arange(4000) / RATE
    motion = np.sin(2 * np.pi * 0.3 * time)
    measured = motion + std * np.random.default_rng(0).standard_normal(len(time))
    cutoff = likeliest_cutoff(measured, RATE, WHITE_SNAP, 0.6)
    assert sample_noise(measured, RATE, WHITE_SNAP, cutoff) == pytest.approx(std, rel=0.12)
    error = kalman_smoother(measured, RATE, cutoff)[0] - motion
    assert np.sqrt(np.mean(error[200:-200] ** 2)) < 0.5 * std


def test_more_noise_means_a_lower_cutoff() -> None:
    time = np.arange(3000) / RATE
    noise = np.random.default_rng(0).standard_normal(len(time))
    cutoffs = [likeliest_cutoff(np.sin(time) + std * noise, RATE, WHITE_SNAP, 0.3) for std in (1e-6, 1e-4, 1e-2)]
    assert cutoffs == sorted(cutoffs, reverse=True)
    assert 0.3 <= cutoffs[-1] < cutoffs[0] <= 1.001 * HIGHEST_CUTOFF * RATE


def test_a_signal_that_rests_has_no_noise() -> None:
    resting = np.full(200, 1.5)
    cutoff = likeliest_cutoff(resting, RATE, WHITE_SNAP, 0.5)
    assert cutoff == pytest.approx(0.5)
    assert sample_noise(resting, RATE, WHITE_SNAP, cutoff) == 0.0
