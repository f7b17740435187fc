"""Physically consistent parameters within the loops of a robust estimate (AUBO .2.3: LMI-SDP in place of LS)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from drivers.core.arrays import FloatArray
from ident.estimators.estimator import Setup
from ident.estimators.feasible.consistent import found_consistent
from ident.estimators.robust.reweighting import Solve
from ident.model.regressor import RegressorKernel
from ident.regression.estimate import estimate_of
from ident.regression.least_squares import LeastSquares, ordinary_least_squares
from ident.regression.observation_matrix import Reduction


def consistent_or_free(setup: Setup, active: Sequence[int]) -> Solve:
    """Least squares whose parameters are replaced by the consistent ones that fit the same system best.

    Where no consistent ones are found, those of least squares stay; the identification reports that at its end.
    """

    def solve(kernel: RegressorKernel, reduction: Reduction, before: FloatArray) -> LeastSquares:
        free = ordinary_least_squares(reduction, active)
        estimate = estimate_of(reduction, free, free.covariance, 0)
        found = found_consistent(kernel.model, setup.base, estimate, setup.robot_file)
        if found is None:
            return free
        parameters = free.parameters.copy()
        parameters[list(active)] = found.base[list(active)]
        return replace(free, parameters=parameters)

    return solve
