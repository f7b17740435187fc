"""Autocorrelation of residuals, and the reduction of their effective number."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drivers.core.arrays import FloatArray
from ident.regression.comparison import TorqueSeries


def residual_autocorrelation(series: Sequence[TorqueSeries]) -> FloatArray:
    """Lag-one autocorrelation (n,) of the residuals, within ±0.99."""
    return lag_one([torques.residual for torques in series])


def lag_one(residuals: Sequence[FloatArray]) -> FloatArray:
    """Lag-one autocorrelation (n,) of series (n, M), within ±0.99."""
    products = sum(np.sum(residual[:, 1:] * residual[:, :-1], axis=1) for residual in residuals)
    squares = sum(np.sum(residual**2, axis=1) for residual in residuals)
    ratio = np.divide(products, squares, out=np.zeros_like(squares), where=np.asarray(squares) > 0)
    return np.asarray(np.clip(ratio, -0.99, 0.99))


def independent_share(autocorrelation: FloatArray) -> float:
    """Share of independent rows among those with lag-one autocorrelations (n,) of the joints, at most 1.

    A sum of N AR(1) values has the variance of N (1 − ρ)/(1 + ρ) independent ones.
    """
    return min(1.0, float(np.mean((1.0 - autocorrelation) / (1.0 + autocorrelation))))
