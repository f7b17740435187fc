"""Autoregressive noise: found in residuals with gaps, and taken out of the equations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import cholesky, toeplitz
from scipy.signal import lfilter

from ident.estimators.methods.ml import WhitenedRows, whitening_filters
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.regressor import RegressorKernel
from ident.signals.filters import no_filter

TRUE = np.array([1.0, -1.2, 0.5])


def noise(samples: int, seed: int = 0) -> np.ndarray:
    return lfilter([1.0], TRUE, np.random.default_rng(seed).standard_normal(samples + 300))[300:]


def test_order_and_coefficients_are_found_in_series_with_gaps():
    residual = noise(20_000)
    counts = np.random.default_rng(1).random(20_000) > 0.02
    filters = whitening_filters([residual, noise(5000, 2)], [counts, np.ones(5000, dtype=bool)], 8)
    assert filters.shape == (3, 3)
    assert filters[-1] == pytest.approx(TRUE, abs=0.03)
    assert whitening_filters([residual], [counts], 4, 1).shape == (2, 2)
    assert whitening_filters([np.zeros(50)], [np.ones(50, dtype=bool)], 3).tolist() == [[1.0]]


def test_whitened_equations_are_those_of_gauss_and_markov(three_joint, smooth_segment):
    """As with the Cholesky factor of the noise's whole covariance, chunk borders included."""
    model = build_model(three_joint)
    kernel = RegressorKernel(model, base_parameters(model).columns, chunk=64)
    segment = smooth_segment(model, 200)
    rng = np.random.default_rng(0)
    segment.torque[:] = rng.standard_normal(segment.torque.shape)
    covariance = np.array([0.7**lag for lag in range(200)])
    filters = np.array([[np.sqrt(1 - 0.49), 0.0], [1.0, -0.7]])  # innovations of variance 1 − 0.7²
    whole = WhitenedRows(kernel, segment, no_filter(), (filters,) * 3)
    parts = [rows for rows in whole if rows.motor == 1]
    white = np.concatenate([rows.torque for rows in parts])
    factor = cholesky(toeplitz(covariance), lower=True)
    expected = np.sqrt(1 - 0.49) * np.linalg.solve(factor, segment.torque[1])
    assert white == pytest.approx(expected, abs=1e-12)
    assert np.concatenate([rows.samples for rows in parts]).tolist() == list(range(200))


def test_white_residuals_of_the_noise_are_white():
    residual = noise(5000)
    filters = whitening_filters([residual], [np.ones(5000, dtype=bool)], 5)
    white = lfilter(filters[-1], [1.0], residual)[10:]
    assert abs(np.corrcoef(white[1:], white[:-1])[0, 1]) < 0.03
