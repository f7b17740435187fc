"""Maximum likelihood with autoregressive noise of the torques."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from pydantic import Field

from drivers.ranges import AR_ORDER
from drivers.streams import FloatArray
from ident.estimators.estimator import Estimation, Estimator, Loop, Setup
from ident.estimators.method import Method, within
from ident.estimators.torque_estimator import TorqueEstimator
from ident.linear_algebra.triangular import QrAccumulator
from ident.regression.autoregression import WhitenedRows, fit_autoregression
from ident.regression.comparison import compare_torques
from ident.regression.jackknife import CorrectedCovariance, FilteredRun
from ident.regression.least_squares import LeastSquares, residual_deviations, weighted_least_squares
from ident.regression.moment_equations import moment_jackknife
from ident.regression.observation_matrix import JointFactor, Reduction
from ident.signals.prepared import Prepared

MOST = 8
"""Largest order that the choice by BIC tries."""

ITERATIONS = 30
SETTLED = 1e-3
"""Largest change of a parameter, over its classical deviation."""


@dataclass(frozen=True)
class MlOptions:
    """Options of maximum likelihood."""

    order: Annotated[
        int | None,
        within(AR_ORDER),
        Field(description=f"of the noise model, every joint alike; by BIC per joint, up to {MOST}, if absent"),
    ] = None


@dataclass(frozen=True, eq=False, kw_only=True)
class MlEstimation(Estimation):
    """An estimate with its noise model.

    Attributes:
        polynomials: of each joint's noise.
    """

    polynomials: tuple[FloatArray, ...]


@dataclass(frozen=True)
class MlEstimator(TorqueEstimator):
    """Weighted least squares of equations whitened by the residual's autoregression, iterated.

    Attributes:
        order: of the noise model; by BIC where None.
    """

    order: int | None

    def estimate(self, runs: Sequence[Prepared], plain: Reduction, active: Sequence[int]) -> Estimation:
        """Parameters and noise model in turn, each the maximum of the likelihood given the other."""
        kernel = self.setup.kernel
        solution = self.solve(plain, active)
        changes: list[float] = []
        while len(changes) < ITERATIONS and (not changes or changes[-1] > SETTLED):
            polynomials = self._polynomials(runs, solution)
            reduction = self._whitened(runs, plain, polynomials)
            refined = self.solve(reduction, active)
            moved = np.abs(refined.parameters - solution.parameters)[list(active)]
            changes.append(float(np.max(moved / refined.std[list(active)])))
            solution = refined
        loop = Loop("parameters and noise model", "σ", tuple(changes), changes[-1] <= SETTLED)
        return MlEstimation(
            kernel,
            reduction,
            self._named(solution, plain),
            (loop,),
            passes=1 + 2 * len(changes),
            polynomials=polynomials,
        )

    def covariance(self, runs: Sequence[FilteredRun], estimation: Estimation) -> CorrectedCovariance:
        """Delete-block jackknife of the whitened equations."""
        assert isinstance(estimation, MlEstimation)
        sources = [
            WhitenedRows(estimation.kernel, segment, run.parallel_filter, estimation.polynomials)
            for run in runs
            for segment in run.segments
        ]
        return moment_jackknife([torques for run in runs for torques in run.series], sources, estimation.solution)

    def restricted(self, estimation: Estimation, columns: Sequence[int]) -> LeastSquares:
        """The whitened equations of fewer columns."""
        return replace(self.solve(estimation.reduction, columns), method="ml")

    def _named(self, solution: LeastSquares, plain: Reduction) -> LeastSquares:
        """The solution with the deviations of the torques' residuals, in place of those of the innovations."""
        deviations = residual_deviations(plain, solution.parameters, len(solution.active))
        return replace(solution, method="ml", joint_std=deviations)

    def _polynomials(self, runs: Sequence[Prepared], solution: LeastSquares) -> tuple[FloatArray, ...]:
        kernel = self.setup.kernel
        residuals, counted = [], []
        for run in runs:
            series = compare_torques(
                kernel.model, kernel.columns, solution.parameters, run.segments, run.parallel_filter
            )
            for torques, segment in zip(series, run.segments, strict=True):
                every = slice(None, None, run.parallel_filter.factor)
                left_out = False if segment.reversing is None else segment.reversing[:, every]
                residuals.append(torques.residual)
                counted.append(torques.used & ~np.broadcast_to(left_out, torques.residual.shape))
        most = MOST if self.order is None else self.order
        return tuple(
            fit_autoregression([part[motor] for part in residuals], [part[motor] for part in counted], most, self.order)
            for motor in range(kernel.model.dof)
        )

    def _whitened(self, runs: Sequence[Prepared], plain: Reduction, polynomials: tuple[FloatArray, ...]) -> Reduction:
        """The plain equations, whitened."""
        kernel = self.setup.kernel
        sums = [QrAccumulator(len(joint.columns) + 1) for joint in plain.joints]
        for run in runs:
            for segment in run.segments:
                for rows in WhitenedRows(kernel, segment, run.parallel_filter, polynomials):
                    if plain.joints[rows.motor].rows:
                        sums[rows.motor].add(np.vstack([rows.regressor, rows.torque]))
        return replace(
            plain,
            joints=tuple(
                JointFactor(joint.columns, part.factor(), part.rows)
                for joint, part in zip(plain.joints, sums, strict=True)
            ),
            method="QR of whitened blocks",
        )


def _estimator(options: MlOptions, setup: Setup) -> Estimator:
    return MlEstimator(setup, weighted_least_squares, options.order)


METHOD = Method(
    "maximum likelihood with autoregressive noise of each joint's torque",
    "torque",
    MlOptions,
    _estimator,
)
