"""Ridge regression (Hoerl and Kennard, Technometrics 12, 1970), its weight by generalised cross-validation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from pydantic import Field

from drivers.core.arrays import FloatArray
from drivers.core.ranges import Range
from ident.estimators.estimator import Estimation, Estimator, Setup
from ident.estimators.method import Method, within
from ident.estimators.torque_estimator import TorqueEstimator
from ident.estimators.triangular_estimation import restricted_solution, triangular_system
from ident.linear_algebra.triangular import triangular
from ident.regression.comparison import compare_torques, independent_share, residual_autocorrelation
from ident.regression.jackknife import CorrectedCovariance, FilteredRun
from ident.regression.least_squares import LeastSquares, weighted_least_squares
from ident.regression.moment_equations import SegmentRows, moment_jackknife
from ident.regression.observation_matrix import Reduction
from ident.signals.prepared import Prepared

WEIGHTS = np.logspace(-10, 1, 111)
"""Weights that are tried, over the squared length of a column."""


@dataclass(frozen=True)
class RidgeOptions:
    """Options of ridge regression."""

    weight: Annotated[
        float | None,
        within(Range(0.0, 1e3)),
        Field(description="of the penalty, over a column's squared length; by generalised cross-validation if absent"),
    ] = None


def cross_validated_weight(factor: FloatArray, rows: float) -> float:
    """The weight of `WEIGHTS` with the least generalised cross-validation (Golub, Heath and Wahba 1979, eq. 1.4).

    Args:
        factor: (a + 1, a + 1) triangular, of columns of unit length and the right-hand side.
        rows: independent equations that it is worth.
    """
    left, singular, _ = np.linalg.svd(factor[:-1, :-1])
    along = (left.T @ factor[:-1, -1]) ** 2
    kept = singular**2 / (singular**2 + WEIGHTS[:, None])
    misfit = factor[-1, -1] ** 2 + np.sum((1.0 - kept) ** 2 * along, axis=1)
    score = misfit / np.maximum(rows - kept.sum(axis=1), 1.0) ** 2
    return float(WEIGHTS[np.argmin(score)])


@dataclass(frozen=True, eq=False, kw_only=True)
class RidgeEstimation(Estimation):
    """An estimate with its penalty.

    Attributes:
        penalty: (b,) weight of each squared base parameter in the sum of squares.
        unbiased: weighted least squares of the same equations.
    """

    penalty: FloatArray
    unbiased: LeastSquares


@dataclass(frozen=True)
class RidgeEstimator(TorqueEstimator):
    """Weighted least squares with a penalty on every parameter, in units of its column's length.

    Attributes:
        weight: of the penalty; by generalised cross-validation where None.
    """

    weight: float | None

    def estimate(self, runs: Sequence[Prepared], plain: Reduction, active: Sequence[int]) -> Estimation:
        """The weights of the joints are those of weighted least squares."""
        unbiased = self.solve(plain, active)
        stacked = plain.stacked(unbiased.weights)
        columns = [*active, plain.column_count]
        lengths = np.linalg.norm(stacked[:, : plain.column_count], axis=0)
        weight = self.weight
        if weight is None:
            scaled = triangular(stacked[:, columns]) / np.append(lengths[list(active)], 1.0)
            weight = cross_validated_weight(scaled, self._independent_rows(runs, plain, unbiased))
        penalty = weight * lengths**2
        system = np.vstack([stacked, np.column_stack([np.diag(np.sqrt(penalty)), np.zeros(len(penalty))])])
        solved = triangular_system(plain, system, unbiased.weights, active, "ridge")
        return RidgeEstimation(
            self.setup.kernel, solved.reduction, solved.solution, passes=2, penalty=penalty, unbiased=unbiased
        )

    def _independent_rows(self, runs: Sequence[Prepared], plain: Reduction, solution: LeastSquares) -> float:
        """Autocorrelated residuals would let the cross-validation overfit: neighbours predict each other."""
        kernel = self.setup.kernel
        series = [
            torques
            for run in runs
            for torques in compare_torques(
                kernel.model, kernel.columns, solution.parameters, run.segments, run.parallel_filter
            )
        ]
        share = independent_share(residual_autocorrelation(series)[solution.weights > 0])
        return max(share * plain.rows, len(solution.active) + 1.0)

    def covariance(self, runs: Sequence[FilteredRun], estimation: Estimation) -> CorrectedCovariance:
        """The jackknife's, plus the square of the estimated bias: the difference from the unpenalised estimate."""
        assert isinstance(estimation, RidgeEstimation)
        active = list(estimation.solution.active)
        sources = [
            SegmentRows(estimation.kernel, segment, run.parallel_filter) for run in runs for segment in run.segments
        ]
        series = [torques for run in runs for torques in run.series]
        spread = moment_jackknife(series, sources, estimation.solution, np.diag(estimation.penalty[active]))
        bias = (estimation.solution.parameters - estimation.unbiased.parameters)[active]
        return replace(spread, covariance=spread.covariance + np.outer(bias, bias))

    def restricted(self, estimation: Estimation, columns: Sequence[int]) -> LeastSquares:
        """The same penalty on fewer columns."""
        return restricted_solution(estimation.reduction, estimation.solution, columns)


def _estimator(options: RidgeOptions, setup: Setup) -> Estimator:
    return RidgeEstimator(setup, weighted_least_squares, options.weight)


METHOD = Method(
    "weighted least squares with a penalty on large parameters; less variance, some bias",
    "torque",
    RidgeOptions,
    _estimator,
)
