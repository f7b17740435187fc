"""Criteria of an excitation: a cost of a path, with its derivatives by the path.

Optimality measures are costs to minimise, with their derivatives. A measure takes A = ΦᵀΦ (b, b), Φ the base regressor
along the motion, and gives a logarithm; all are of similar size. λ are A's eigenvalues. Largest and smallest eigenvalue
are smoothed by power means of order `sharpness`, Σλ^p ^ (1/p) and (Σλ^-p) ^ (-1/p), which tend to them from outside as
p grows: the largest is over-, the smallest underestimated, so a condition number is never underestimated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from drivers.core.arrays import FloatArray
from ident.excite.path import JointPath
from ident.model.dynamic_model import DynamicModel
from ident.model.regressor import RegressorKernel
from ident.model.regressor_gradient import pull_back_regressor

Measure = Callable[[FloatArray, float], tuple[float, FloatArray]]
"""(A (b, b), sharpness) → cost and its symmetric derivative (b, b)."""

_FLOOR = 1e-14
"""Eigenvalues below this share of the largest are raised to this: a cost must be finite where nothing is excited."""


def plain_condition(gram: FloatArray, sharpness: float) -> tuple[float, FloatArray]:
    """Log cond(Φ)."""
    values, vectors = _eigen(gram)
    largest, of_largest = _log_largest(values, sharpness)
    smallest, of_smallest = _log_smallest(values, sharpness)
    return 0.5 * (largest - smallest), _rotated(vectors, 0.5 * (of_largest - of_smallest))


def condition(gram: FloatArray, sharpness: float) -> tuple[float, FloatArray]:
    """Log cond(Φ), column-normalised: independent of the units of the parameters."""
    scaled, lengths = _unit_columns(gram)
    cost, gradient = plain_condition(scaled, sharpness)
    return cost, _through_scaling(gradient, scaled, lengths)


def d_optimal(gram: FloatArray, sharpness: float) -> tuple[float, FloatArray]:
    """−log det A / b: the volume of the parameters' confidence ellipsoid."""
    values, vectors = _eigen(gram)
    return float(-np.mean(np.log(values))), _rotated(vectors, -1.0 / (len(values) * values))


def e_optimal(gram: FloatArray, sharpness: float) -> tuple[float, FloatArray]:
    """−log λ_min: the longest axis of that ellipsoid."""
    values, vectors = _eigen(gram)
    smallest, gradient = _log_smallest(values, sharpness)
    return -smallest, _rotated(vectors, -gradient)


def deviations(scale: FloatArray) -> Measure:
    """½ log of the mean of (σ_i/scale_i)², σ the standard deviations that least squares will have.

    A must hold the weights of the joints' noise. With the parameters' sizes (b,) as `scale` it is the mean square of
    the relative standard deviations.
    """

    def measure(gram: FloatArray, sharpness: float) -> tuple[float, FloatArray]:
        values, vectors = _eigen(gram)
        inverse = _rotated(vectors, 1.0 / values)
        share = np.diag(inverse) / scale**2
        weighted = inverse @ (inverse / scale[:, None] ** 2)
        return 0.5 * float(np.log(np.mean(share))), -0.5 * (weighted + weighted.T) / (2.0 * np.sum(share))

    return measure


def moments_apart(first: tuple[int, ...], second: tuple[int, ...]) -> Measure:
    """log(cond(Φ1) + cond(Φ2)) of the columns of first and of second moments (AUBO eq. 21), column-normalised.

    Masses belong to the first moments, in whose base parameters they end.
    """

    def measure(gram: FloatArray, sharpness: float) -> tuple[float, FloatArray]:
        total, gradient = 0.0, np.zeros_like(gram)
        for columns in (first, second):
            if columns:
                submatrix = np.ix_(columns, columns)
                cost, derivative = condition(gram[submatrix], sharpness)
                total += np.exp(cost)
                gradient[submatrix] += np.exp(cost) * derivative
        return float(np.log(total)), gradient / total

    return measure


def _eigen(gram: FloatArray) -> tuple[FloatArray, FloatArray]:
    values, vectors = np.linalg.eigh(gram)
    return np.maximum(values, max(_FLOOR * float(values[-1]), np.finfo(float).tiny)), vectors


def _log_largest(values: FloatArray, sharpness: float) -> tuple[float, FloatArray]:
    """Log of the power mean of order p, and its derivatives by the eigenvalues."""
    if np.isinf(sharpness):
        shares = np.zeros_like(values)
        shares[-1] = 1.0
        return float(np.log(values[-1])), shares / values
    powers = (values / values[-1]) ** sharpness
    total = powers.sum()
    return float(np.log(values[-1]) + np.log(total) / sharpness), powers / total / values


def _log_smallest(values: FloatArray, sharpness: float) -> tuple[float, FloatArray]:
    inverse = 1.0 / values[::-1]
    largest, gradient = _log_largest(inverse, sharpness)
    return -largest, (gradient * inverse**2)[::-1]


def _rotated(vectors: FloatArray, diagonal: FloatArray) -> FloatArray:
    return np.asarray((vectors * diagonal) @ vectors.T)


def _unit_columns(gram: FloatArray) -> tuple[FloatArray, FloatArray]:
    lengths = np.sqrt(np.diag(gram))
    lengths = np.where(lengths > 0.0, lengths, 1.0)
    return gram / np.outer(lengths, lengths), lengths


def _through_scaling(gradient: FloatArray, scaled: FloatArray, lengths: FloatArray) -> FloatArray:
    """Turn the derivative by the scaled matrix into the one by the matrix: A_ij = S_ij l_i l_j, l_i² = A_ii."""
    by_length = np.sum(gradient * scaled, axis=1) / lengths**2
    return gradient / np.outer(lengths, lengths) - np.diag(by_length)


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
        self, model: DynamicModel, columns: Sequence[int], measure: Measure, joint_weights: FloatArray | None = None
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
