"""The Kalman smoother against filterpy's own loops, and what it is as a low-pass."""

from __future__ import annotations

import math

import numpy as np
import pytest
from each import each
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import KalmanFilter

from ident.signals.smoothing.kalman import (
    WHITE_CURVATURE,
    WHITE_SNAP,
    cutoff_of_noise,
    innovations,
    kalman_smoother,
    stationary_filter,
)

RATE = 200.0


def signal(samples: int) -> np.ndarray:
    time = np.arange(samples) / RATE
    noise = 1e-3 * np.random.default_rng(0).standard_normal(samples)
    return np.sin(2 * np.pi * 0.4 * time) + 0.3 * np.cos(2 * np.pi * time) + noise


def by_filterpy(samples: np.ndarray, cutoff: float, order: int) -> np.ndarray:
    stationary = stationary_filter(2 * np.pi * cutoff / RATE, order)
    kalman = KalmanFilter(order, 1)
    kalman.F, kalman.Q, kalman.H = stationary.transition, stationary.process, np.eye(1, order)
    kalman.x, kalman.P = np.zeros((order, 1)), 1e8 * np.eye(order)
    kalman.x[0] = samples[0]
    means, covariances, _, _ = kalman.batch_filter(samples)
    smoothed, _, _, _ = kalman.rts_smoother(means, covariances)
    return smoothed[:, :, 0].T * (2 * np.pi * cutoff) ** np.arange(order)[:, None]


@pytest.mark.parametrize("samples", [16, 1500])
@pytest.mark.parametrize(
    ("cutoff", "order"), [(2.0, WHITE_SNAP), (20.0, WHITE_SNAP), (60.0, 3), (8.0, WHITE_CURVATURE)]
)
def test_equal_to_filterpy_sample_by_sample(samples: int, cutoff: float, order: int) -> None:
    rows = signal(samples)
    ours, theirs = kalman_smoother(rows, RATE, cutoff, order), by_filterpy(rows, cutoff, order)
    assert ours.shape == (order, samples)
    assert np.all(np.abs(ours - theirs).max(axis=1) < 1e-9 * np.abs(theirs).max(axis=1))


@each("order", [WHITE_CURVATURE, WHITE_SNAP])
@each("frequency", [1.0, 4.0, 6.0])
def test_the_smoother_is_a_zero_phase_butterworth(order: int, frequency: float) -> None:
    cutoff = 4.0
    time = np.arange(4000) / RATE
    wave = np.exp(2j * np.pi * frequency * time)
    inner = slice(1000, 3000)
    for derivative, row in enumerate(kalman_smoother(wave.imag, RATE, cutoff, order)[:2]):
        ratio = 2 * np.mean(row[inner] * wave[inner].conj()) * 1j / (2j * np.pi * frequency) ** derivative
        assert ratio == pytest.approx(1 / (1 + (frequency / cutoff) ** (2 * order)), abs=2e-3)


def test_a_polynomial_of_the_model_passes_unchanged() -> None:
    time = np.arange(600) / RATE
    cubic = 1 - time + 0.5 * time**2 - 0.2 * time**3
    position, velocity, acceleration, _ = kalman_smoother(cubic, RATE, 5.0)
    np.testing.assert_allclose(position, cubic, atol=1e-6)
    np.testing.assert_allclose(velocity, -1 + time - 0.6 * time**2, atol=1e-4)
    np.testing.assert_allclose(acceleration, 1 - 1.2 * time, atol=1e-2)


def test_innovations_of_the_model_are_white() -> None:
    step, order, samples = 0.3, WHITE_CURVATURE, 20_000
    stationary = stationary_filter(step, order)
    generator = np.random.default_rng(1)
    driving = np.linalg.cholesky(stationary.process) @ generator.standard_normal((order, samples))
    state, measured = np.zeros(order), np.empty(samples)
    for index in range(samples):
        state = stationary.transition @ state + driving[:, index]
        measured[index] = state[0] + generator.standard_normal()
    errors = innovations(measured, step, order)[200:]
    assert errors.var() == pytest.approx(stationary.innovation, rel=0.05)
    correlation = [np.mean(errors[lag:] * errors[: len(errors) - lag]) / errors.var() for lag in range(1, 6)]
    assert np.abs(correlation).max() < 4 / np.sqrt(samples)


@pytest.mark.parametrize(("density", "variance"), [(1e4, 1e-6), (3e6, 1e-8)])
def test_stated_noise_levels_are_those_of_filterpy_in_seconds(density: float, variance: float) -> None:
    rows = signal(600)
    kalman = KalmanFilter(WHITE_SNAP, 1)
    powers = np.subtract.outer(np.arange(WHITE_SNAP), np.arange(WHITE_SNAP))
    kalman.F = np.array([[RATE**p / math.factorial(-p) if p <= 0 else 0.0 for p in row] for row in powers.tolist()])
    kalman.Q = Q_continuous_white_noise(WHITE_SNAP, dt=1.0 / RATE, spectral_density=density)
    kalman.R, kalman.H = np.array([[variance]]), np.eye(1, WHITE_SNAP)
    kalman.x, kalman.P = np.zeros((WHITE_SNAP, 1)), 1e8 * np.eye(WHITE_SNAP)
    kalman.x[0] = rows[0]
    means, covariances, _, _ = kalman.batch_filter(rows)
    smoothed, _, _, _ = kalman.rts_smoother(means, covariances)
    ours = kalman_smoother(rows, RATE, cutoff_of_noise(density, variance, RATE, WHITE_SNAP), WHITE_SNAP)
    inner = slice(150, 450)
    for derivative in range(3):
        theirs = smoothed[inner, derivative, 0]
        assert np.abs(ours[derivative, inner] - theirs).max() < 1e-5 * np.abs(theirs).max()
