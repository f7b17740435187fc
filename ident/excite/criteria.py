"""Criteria of an excitation: a cost of a path, with its derivatives by the path."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from drivers.core.arrays import FloatArray
from ident.excite.measures import Measure
from ident.excite.path import JointPath
from ident.model.dynamic_model import DynamicModel
from ident.model.regressor import RegressorKernel
from ident.model.regressor_gradient import pull_back_regressor

SIGN_SMOOTHING = 0.05
"""Least ε [rad/s] of tanh(q̇/ε) in place of sign(q̇) while designing: a step has no derivative to follow."""


class Criterion(Protocol):
    """A cost of a path: the smaller, the better the excitation."""

    def cost(self, path: JointPath) -> float:
        """Exactly as the criterion is defined; inf where the path excites nothing."""

    def smooth_cost(self, path: JointPath, sharpness: float) -> tuple[float, FloatArray]:
        """A smooth bound of the cost and its derivatives (3, n, N) by position, velocity and acceleration."""


class RegressorCriterion:
    """A measure of the mean information matrix Σ_j w_j² Φ_jᵀΦ_j / N of a model's columns along a path.

    Args:
        model: of the arm.
        columns: standard columns, the base parameters' as a rule.
        measure: of the information matrix (module `measures`).
        joint_weights: (n,) w_j, 1/σ_j of each joint's torque noise; all 1 where None.

    Attributes:
        columns: as given.
    """

    def __init__(
        self,
        model: DynamicModel,
        columns: Sequence[int],
        measure: Measure,
        joint_weights: FloatArray | None = None,
    ) -> None:
        self._model = model
        self.columns = tuple(columns)
        self._measure = measure
        self._squares = np.ones(model.dof) if joint_weights is None else np.asarray(joint_weights) ** 2
        self._smooth_model = replace(model, smoothing=max(model.smoothing, SIGN_SMOOTHING))
        self._kernels: dict[tuple[bool, int], RegressorKernel] = {}

    def cost(self, path: JointPath) -> float:
        """The measure, its extreme eigenvalues taken exactly."""
        return self._measure(self.information(path), np.inf)[0]

    def smooth_cost(self, path: JointPath, sharpness: float) -> tuple[float, FloatArray]:
        """The measure with power means of order `sharpness` and smoothed signs of q̇; its derivatives (3, n, N)."""
        kernel, packed = self._evaluated(path, smooth=True)
        cost, by_information = self._measure(self._gram(kernel, packed), sharpness)
        weights = np.empty_like(packed)
        for joint, rows in enumerate(kernel.joint_rows):
            columns = list(rows.columns)
            factor = 2.0 / len(path.time) * self._squares[joint] * by_information[np.ix_(columns, columns)]
            np.matmul(factor, packed[rows.rows], out=weights[rows.rows])
        return cost, pull_back_regressor(kernel, path.position, path.velocity, path.acceleration, weights)

    def information(self, path: JointPath) -> FloatArray:
        """The information matrix (b, b) that one sample brings in the mean."""
        return self._gram(*self._evaluated(path, smooth=False))

    def _evaluated(self, path: JointPath, *, smooth: bool) -> tuple[RegressorKernel, FloatArray]:
        count = len(path.time)
        if (smooth, count) not in self._kernels:
            model = self._smooth_model if smooth else self._model
            self._kernels[smooth, count] = RegressorKernel(model, self.columns, chunk=count)
        kernel = self._kernels[smooth, count]
        packed = np.empty((kernel.row_count, count))
        kernel.evaluate(path.position, path.velocity, path.acceleration, packed)
        return kernel, packed

    def _gram(self, kernel: RegressorKernel, packed: FloatArray) -> FloatArray:
        gram = np.zeros((len(self.columns), len(self.columns)))
        for joint, rows in enumerate(kernel.joint_rows):
            columns = list(rows.columns)
            gram[np.ix_(columns, columns)] += self._squares[joint] * (packed[rows.rows] @ packed[rows.rows].T)
        gram /= packed.shape[1]
        return gram


class MotionSize:
    """log J, J = 1/‖QᵀQ‖₂ with a row q, q̇, q̈ of all joints per sample in Q (UP6 eq. 12).

    It rewards large motion only; check the condition number as well.
    """

    def cost(self, path: JointPath) -> float:
        """−log of the largest eigenvalue of QᵀQ."""
        return float(-np.log(np.linalg.eigvalsh(self._gram(path))[-1]))

    def smooth_cost(self, path: JointPath, sharpness: float) -> tuple[float, FloatArray]:
        """The same: the largest eigenvalue of these matrices is simple."""
        stacked = self._stacked(path)
        values, vectors = np.linalg.eigh(self._gram(path))
        direction = vectors[:, -1]
        gradient = -2.0 * np.outer(direction, direction @ stacked) / values[-1]
        return float(-np.log(values[-1])), gradient.reshape(3, *path.position.shape)

    def _stacked(self, path: JointPath) -> FloatArray:
        return np.concatenate([path.position, path.velocity, path.acceleration])

    def _gram(self, path: JointPath) -> FloatArray:
        stacked = self._stacked(path)
        return np.asarray(stacked @ stacked.T)
