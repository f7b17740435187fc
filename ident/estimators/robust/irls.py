"""Iteratively reweighted least squares across the joints (AUBO .2.3; Han et al. 2020)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.estimators.estimator import Estimation, Loop, Setup
from ident.estimators.robust.consistency import consistent_or_free
from ident.estimators.robust.jackknife import whitened_jackknife
from ident.estimators.robust.reweighting import COVARIANCE_TOLERANCE, PARAMETER_TOLERANCE, Reweighting, RobustFit, Solve
from ident.estimators.robust.weight_functions import WeightName, weight_function
from ident.estimators.torque_estimator import reduce_torques
from ident.regression.jackknife import CorrectedCovariance, FilteredRun
from ident.regression.least_squares import LeastSquares, ordinary_least_squares
from ident.regression.observation_matrix import Reduction
from ident.signals.prepared import Prepared, Step


@dataclass(frozen=True)
class RobustEstimator:
    """IRLS on the joints' torque equations.

    Attributes:
        setup: the data.
        weights: name of the weight function.
        consistent: whether residuals, weights and Ω are those of the physically consistent parameters.
    """

    setup: Setup
    weights: WeightName
    consistent: bool

    def notes(self, run: Prepared) -> tuple[Step, ...]:
        """Nothing that is not in the list."""
        return ()

    def reduce(self, runs: Sequence[Prepared]) -> Reduction:
        """One factor per joint."""
        return reduce_torques(self.setup.kernel, runs, self.setup.experiment.torques)

    def estimate(self, runs: Sequence[Prepared], plain: Reduction, active: Sequence[int]) -> Estimation:
        """Iterate from weighted least squares until Ω and the weights settle."""
        loops = reweighting(self.setup, self.weights, runs, plain, active, self.solver(active))
        return estimation(loops.started(self.setup.kernel, plain), loops, "irls")

    def solver(self, active: Sequence[int]) -> Solve:
        """Least squares, or what is physically consistent of it."""
        if self.consistent:
            return consistent_or_free(self.setup, active)
        return lambda kernel, reduction, before: ordinary_least_squares(reduction, active)

    def covariance(self, runs: Sequence[FilteredRun], estimation: Estimation) -> CorrectedCovariance:
        """Delete-block jackknife on the whitened equations with the last weights."""
        function = weight_function(self.weights, estimation.solution.rows - len(estimation.solution.active))
        return whitened_jackknife(estimation, runs, self.setup.experiment.torques, function.steepness)

    def restricted(self, estimation: Estimation, columns: Sequence[int]) -> LeastSquares:
        """Least squares with the last weights and Ω."""
        return replace(ordinary_least_squares(estimation.reduction, columns), method=estimation.solution.method)


def reweighting(
    setup: Setup, weights: WeightName, runs: Sequence[Prepared], plain: Reduction, active: Sequence[int], solve: Solve
) -> Reweighting:
    """The inner loops on these data."""
    function = weight_function(weights, plain.rows - len(active))
    return Reweighting.of(runs, setup.experiment.torques, plain, active, function, solve)


def estimation(fit: RobustFit, loops: Reweighting, method: str) -> Estimation:
    """What the inner loops ended with, as an estimator gives it: least squares of the last whitened system."""
    solution = ordinary_least_squares(fit.done.reduction, loops.active)
    settled = loops.changes[-1] < COVARIANCE_TOLERANCE, loops.steps[-1] < PARAMETER_TOLERANCE
    return Estimation(
        kernel=fit.kernel,
        reduction=fit.done.reduction,
        solution=replace(
            solution,
            method=method,
            joint_std=np.sqrt(np.diag(fit.covariance)),
            iterations=len(loops.steps),
            settled=fit.settled,
        ),
        loops=(
            Loop("covariance of the joints, relative change", "", tuple(loops.changes), settled[0]),
            Loop("weights, largest step of a parameter", "σ", tuple(loops.steps), settled[1]),
        ),
        weights=fit.done.weights,
        passes=loops.passes,
        joint_covariance=fit.covariance,
    )
