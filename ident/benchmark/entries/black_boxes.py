"""Methods that know nothing of rigid bodies, as a check on the benchmark: a model has to be better than these."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from drivers.core.arrays import FloatArray
from ident.benchmark.entry import TorquePredictor, Training

NEIGHBOURS = 5
PENALTY = 1e-3
"""Weight of the ridge regression's penalty, per row, on columns of unit variance."""


def _states(q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
    return np.concatenate([q, dq, ddq], axis=1)


def _stacked(training: Training) -> tuple[FloatArray, FloatArray]:
    parts = [
        (_states(motion.q, motion.dq, motion.ddq)[motion.inner], motion.in_band(motion.torque)[motion.inner])
        for motion in training.motions
    ]
    return np.concatenate([states for states, _ in parts]), np.concatenate([torque for _, torque in parts])


def nearest_neighbour(training: Training) -> TorquePredictor:
    """Mean torque of the nearest training states, each coordinate in its standard deviations."""
    states, torques = _stacked(training)
    scale = np.maximum(states.std(axis=0), 1e-9)
    tree = cKDTree(states / scale)

    def torque(q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        _, nearest = tree.query(_states(q, dq, ddq) / scale, k=NEIGHBOURS)
        return np.asarray(torques[nearest].mean(axis=1), dtype=np.float64)

    return TorquePredictor(torque)


def ridge(training: Training) -> TorquePredictor:
    """Ridge regression on sines and cosines of the positions, velocities, their signs and accelerations."""
    states, torques = _stacked(training)

    def features(states: FloatArray) -> FloatArray:
        q, dq, ddq = np.split(states, 3, axis=1)
        return np.concatenate([np.sin(q), np.cos(q), dq, np.sign(dq), ddq], axis=1)

    columns = features(states)
    mean, scale = columns.mean(axis=0), np.maximum(columns.std(axis=0), 1e-9)
    scaled, level = (columns - mean) / scale, torques.mean(axis=0)
    normal = scaled.T @ scaled + PENALTY * len(scaled) * np.eye(scaled.shape[1])
    weights = np.linalg.solve(normal, scaled.T @ (torques - level))

    def torque(q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        given = (features(_states(q, dq, ddq)) - mean) / scale
        return np.asarray(given @ weights + level, dtype=np.float64)

    return TorquePredictor(torque)
