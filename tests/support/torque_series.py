"""Torques of two joints, measured with noise and predicted."""

from __future__ import annotations

import numpy as np

from ident.regression.comparison import TorqueSeries


def series(start: float = 0.0, samples: int = 300, *, rate: float = 100.0, seed: int = 0) -> TorqueSeries:
    time = start + np.arange(samples) / rate
    velocity = np.vstack([np.sin(time), np.cos(2 * time)])
    predicted = np.vstack([20 * np.cos(time), 5 * np.sin(2 * time)])
    noise = np.random.default_rng(seed).standard_normal(predicted.shape)
    return TorqueSeries(time, predicted + 0.1 * noise, predicted, velocity, np.ones(samples, dtype=np.bool_))
