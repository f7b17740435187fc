"""Total least squares with the errors of W and τ as the data show them (Golub and Van Loan 1980; Van Huffel 1991)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from ident.estimators.estimator import Estimation, Estimator, Loop, Setup
from ident.estimators.method import Method, NoOptions
from ident.estimators.position_noise import noise_deviations, regressor_noise
from ident.estimators.torque_estimator import TorqueEstimator
from ident.estimators.triangular_estimation import restricted_solution, triangular_system
from ident.linear_algebra.triangular import gram_root
from ident.regression.jackknife import CorrectedCovariance, FilteredRun
from ident.regression.least_squares import (
    LeastSquares,
    inverse_deviations,
    residual_deviations,
    weighted_least_squares,
)
from ident.regression.moment_equations import SegmentRows, moment_jackknife
from ident.regression.observation_matrix import Reduction
from ident.regression.total_least_squares import total_least_squares
from ident.signals.prepared import Prepared

ITERATIONS = 50
SETTLED_CHANGE = 1e-6
LEAST_TORQUE_NOISE = 0.01
"""Share of the residual that counts as noise of the torque at least."""


@dataclass(frozen=True, eq=False, kw_only=True)
class TlsEstimation(Estimation):
    """An estimate with what was taken off the normal matrix.

    Attributes:
        correction: (b, b) λ·C, weighted.
    """

    correction: FloatArray


@dataclass(frozen=True)
class TlsEstimator(TorqueEstimator):
    """Total least squares: the errors of W's columns from the positions' noise, those of τ from the residual."""

    def estimate(self, runs: Sequence[Prepared], plain: Reduction, active: Sequence[int]) -> Estimation:
        """Weights and noise of the torque follow from the residual, iterated."""
        kernel = self.setup.kernel
        of_runs = [regressor_noise(kernel, run, noise_deviations(run), plain) for run in runs]
        noise = [sum(parts) for parts in zip(*of_runs, strict=True)]
        solution = self.solve(plain, active)
        parameters, weights, columns = solution.parameters, solution.weights, list(active)
        changes: list[float] = []
        while len(changes) < ITERATIONS and (not changes or changes[-1] > SETTLED_CHANGE):
            errors = np.zeros((plain.column_count, plain.column_count))
            for joint, weight, gram in zip(plain.joints, weights, noise, strict=True):
                errors[np.ix_(joint.columns, joint.columns)] += weight**2 * gram
            of_torque = max(plain.rows - float(parameters @ errors @ parameters), LEAST_TORQUE_NOISE * plain.rows)
            factor = plain.stacked(weights)
            values, share = total_least_squares(
                factor[:, [*columns, plain.column_count]], errors[np.ix_(columns, columns)], of_torque
            )
            change = np.max(np.abs(values - parameters[columns]) / solution.std[columns])
            parameters = parameters.copy()
            parameters[columns] = values
            weights = inverse_deviations(plain, residual_deviations(plain, parameters, len(columns)))
            changes.append(float(change))
        normal = factor.T @ factor
        correction = share * errors
        root = gram_root(normal[:-1, :-1] - correction)
        right = np.linalg.lstsq(root.T, normal[:-1, -1], rcond=1e-12)[0]
        system = np.column_stack([root, right])
        solved = triangular_system(plain, system, weights, active, "tls", len(changes))
        loop = Loop("weights and noise of the torque", "σ", tuple(changes), changes[-1] <= SETTLED_CHANGE)
        return TlsEstimation(kernel, solved.reduction, solved.solution, (loop,), passes=3, correction=correction)

    def covariance(self, runs: Sequence[FilteredRun], estimation: Estimation) -> CorrectedCovariance:
        """Delete-block jackknife with the errors' share held."""
        assert isinstance(estimation, TlsEstimation)
        active = list(estimation.solution.active)
        sources = [
            SegmentRows(estimation.kernel, segment, run.parallel_filter) for run in runs for segment in run.segments
        ]
        series = [torques for run in runs for torques in run.series]
        return moment_jackknife(series, sources, estimation.solution, -estimation.correction[np.ix_(active, active)])

    def restricted(self, estimation: Estimation, columns: Sequence[int]) -> LeastSquares:
        """The corrected system of fewer columns."""
        return restricted_solution(estimation.reduction, estimation.solution, columns)


def _estimator(options: NoOptions, setup: Setup) -> Estimator:
    return TlsEstimator(setup, weighted_least_squares)


METHOD = Method(
    "total least squares: positions have noise, too, estimated from what is left of them above the motion's band",
    "torque",
    NoOptions,
    _estimator,
)
