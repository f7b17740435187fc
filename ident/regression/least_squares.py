"""Ordinary and weighted least squares on a reduced system (SR400 .4.3; ROCR6 eq. 10-12, misprints corrected)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import IdentificationError
from ident.linear_algebra.triangular import scaled_condition
from ident.regression.observation_matrix import Reduction

LinearMethod = Literal["ols", "wls"]

EXCITATION_TOLERANCE = 1e-9
"""A base column with an independent component below this share of its length is not excited, nor one
that is shorter than this share of the longest: the derivative of a position that never changes is rounding."""

RESIDUAL_FLOOR = 1e-7
"""A residual below this share of the joint's torque is rounding, and no measure of its noise."""

LEAST_TORQUE = 1e-9
"""[N·m or N] No sensor resolves so little: a torque that is recorded as 0 gets no larger weight than this."""

FITTED_PER_COLUMN = 2.0
"""Equations per column of its own that a joint follows whatever their noise, columns that other joints leave open
included: with 6 to 16 equations the residual of a joint that is held was 0.1 to 0.5 of its noise."""

WLS_TOLERANCE = 1e-8
WLS_ITERATIONS = 100


@dataclass(frozen=True)
class LeastSquares:
    """A least-squares solution."""

    method: str  # name of the fit and its weighting
    active: tuple[int, ...]  # indices of the base columns that were estimated
    parameters: FloatArray  # (b,) base parameters; 0 for those that were not estimated
    covariance: FloatArray  # (a, a) of the active ones, residuals assumed white (SR400 eq. 14).
    inverse: FloatArray  # (a, a) inverse of the (weighted) normal matrix
    # (n,) what each joint's rows were multiplied with, 0 without rows; (1,) where all rows form one factor
    weights: FloatArray
    # (n,) standard deviation of each joint's residual [N·m], 0 without rows; (1,) of the energy's [J] or power's [W]
    joint_std: FloatArray
    rows: int  # r, the number of equations
    condition: float  # of the active columns as they are (weighted), SR400's criterion
    scaled_condition: float  # the same with columns of unit length
    residual_sum: float  # Σ ρ² of the weighted system
    iterations: int  # of the weights; 1 for OLS
    settled: bool = True  # whether the weights converged; else these are the last iterate's

    @property
    def std(self) -> FloatArray:
        """Classical standard deviations (b,); inf where a parameter was not estimated."""
        deviations = np.full(len(self.parameters), np.inf)
        deviations[list(self.active)] = np.sqrt(np.diag(self.covariance))
        return deviations


def excited_columns(reduction: Reduction) -> tuple[int, ...]:
    """Base columns that the data can identify: each has a component that is independent of those before it."""
    factor = reduction.stacked()[:, : reduction.column_count]
    lengths = np.linalg.norm(factor, axis=0)
    return tuple(
        column
        for column in range(reduction.column_count)
        if lengths[column] > EXCITATION_TOLERANCE * lengths.max()
        and abs(factor[column, column]) > EXCITATION_TOLERANCE * lengths[column]
    )


def ordinary_least_squares(reduction: Reduction, active: Sequence[int]) -> LeastSquares:
    """OLS over all joints' rows with equal weight.

    Raises:
        IdentificationError: fewer equations than parameters, or columns that depend on each other.
    """
    return solve_weighted(reduction, active, (reduction.joint_rows > 0).astype(np.float64), "ols")


def weighted_least_squares(
    reduction: Reduction, active: Sequence[int], weights: FloatArray | None = None
) -> LeastSquares:
    """WLS: each joint's rows divided by its residual's standard deviation, iterated until the weights settle.

    σ_j² = ‖Γ_j − W_j θ‖² / (N_j − b·N_j/r) (ROCR6 eq. 11 with the joint's share of the parameters as r_j). Where they
    do not settle, the last iterate is given, marked: it is a weighted solution, too, with weights that are not final.

    Args:
        reduction: the system.
        active: base columns that are estimated.
        weights: (n,) of the joints' rows to begin with, as of a solution of nearly the same system; OLS where None.

    Raises:
        IdentificationError: as for OLS.
    """
    active = tuple(active)
    floor, used = rounding_floor(reduction), reduction.joint_rows > 0
    weights = used.astype(np.float64) if weights is None else weights
    system = _solved(reduction, active, weights)
    joint_std = residual_deviations(reduction, system.parameters, len(active))
    for iteration in range(2, WLS_ITERATIONS + 2):
        weights = np.where(used, 1.0 / np.maximum(joint_std, floor), 0.0)
        system = _solved(reduction, active, weights)
        joint_std = residual_deviations(reduction, system.parameters, len(active))
        if np.max(np.abs(np.maximum(joint_std, floor) * weights - 1.0)[used]) < WLS_TOLERANCE:
            return _least_squares(reduction, active, weights, system, "wls", iteration)
    return replace(_least_squares(reduction, active, weights, system, "wls", iteration), settled=False)


def rounding_floor(reduction: Reduction) -> FloatArray:
    """Standard deviations (n,) below which a joint's weight must not follow its residual: noise-free data."""
    torque = reduction.torques
    return np.asarray(RESIDUAL_FLOOR * np.maximum(torque, max(1e-9 * float(np.max(torque)), LEAST_TORQUE)))


def inverse_deviations(reduction: Reduction, joint_std: FloatArray) -> FloatArray:
    """Weights (n,) 1/σ of each joint's rows from the deviations σ (n,) of its residual [N·m]; 0 without rows."""
    return np.where(reduction.joint_rows > 0, 1.0 / np.maximum(joint_std, rounding_floor(reduction)), 0.0)


def residual_deviations(reduction: Reduction, parameters: FloatArray, count: int) -> FloatArray:
    """Standard deviation (n,) of each joint's residual for base parameters (b,), `count` of which were estimated.

    A joint with hardly more equations than columns of its own is fitted beyond its noise, and its weight would grow
    without end: the fewer it has, the less its deviation falls below the joints' common share of the torque.
    """
    rows, square = reduction.joint_rows, reduction.torques**2
    freedom = np.maximum(rows * (reduction.rows - count) / reduction.rows, 1.0)
    variance = reduction.residual_sums(parameters) / freedom
    shares = np.divide(variance, square, out=np.ones(len(rows)), where=square > 0.0)
    common = np.exp(np.average(np.log(np.maximum(shares, RESIDUAL_FLOOR**2)), weights=rows)) * square
    # Equations that speak for the common share.
    added = (FITTED_PER_COLUMN * reduction.own_columns) ** 3 / np.maximum(rows, 1.0) ** 2
    return np.asarray(np.sqrt(variance + np.maximum(common - variance, 0.0) * added / (freedom + added)))


def solve_weighted(
    reduction: Reduction, active: Sequence[int], weights: FloatArray, method: str, iterations: int = 1
) -> LeastSquares:
    """Least squares with given weights (n,) of the joints' rows.

    Raises:
        IdentificationError: fewer equations than parameters, or columns that depend on each other.
    """
    active = tuple(active)
    return _least_squares(reduction, active, weights, _solved(reduction, active, weights), method, iterations)


@dataclass(frozen=True)
class _System:
    """A weighted system of the active columns, and its solution: all that iterated weights need."""

    square: FloatArray  # R (a, a)
    lengths: FloatArray  # of its columns (a,)
    parameters: FloatArray  # (b,)
    residual_sum: float  # Σ ρ²


def _solved(reduction: Reduction, active: tuple[int, ...], weights: FloatArray) -> _System:
    count = len(active)
    if not reduction.rows:
        raise IdentificationError(
            "no sample counts: in all of them the arm rests or is near a velocity reversal",
            hint="record a motion of `dynid excite`",
        )
    if reduction.rows <= count:
        raise IdentificationError(
            f"{reduction.rows} equations cannot determine {count} parameters", hint="record longer or decimate less"
        )
    factor = reduction.stacked(weights, active)
    square, right = factor[:count, :count], factor[:count, count]
    lengths = np.linalg.norm(square, axis=0)
    if count and not np.all(np.abs(np.diag(square)) > EXCITATION_TOLERANCE * lengths):
        raise IdentificationError("the columns of the system are linearly dependent", hint="record a richer motion")
    parameters = np.zeros(reduction.column_count)
    parameters[list(active)] = np.linalg.solve(square / lengths, right) / lengths
    residual_sum = float(factor[count, count] ** 2) if factor.shape[0] > count else 0.0
    return _System(square, lengths, parameters, residual_sum)


def _least_squares(
    reduction: Reduction, active: tuple[int, ...], weights: FloatArray, system: _System, method: str, iterations: int
) -> LeastSquares:
    """The solution with its covariance and condition."""
    count, square, lengths = len(active), system.square, system.lengths
    inverse_factor = np.linalg.solve(square / lengths, np.eye(count)) / lengths[:, None]
    inverse = inverse_factor @ inverse_factor.T
    singular = np.linalg.svd(square, compute_uv=False) if count else np.ones(1)
    return LeastSquares(
        method=method,
        active=active,
        parameters=system.parameters,
        covariance=system.residual_sum / (reduction.rows - count) * inverse,
        inverse=inverse,
        weights=weights,
        joint_std=residual_deviations(reduction, system.parameters, count),
        rows=reduction.rows,
        condition=float(singular[0] / singular[-1]),
        scaled_condition=scaled_condition(square) if count else 1.0,
        residual_sum=system.residual_sum,
        iterations=iterations,
    )
