"""Least squares on the joints' torque equations, one factor per joint (SR400 eq. 13)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ident.estimators.estimator import Estimation, Setup
from ident.model.regressor import RegressorKernel
from ident.regression.jackknife import CorrectedCovariance, FilteredRun, block_jackknife
from ident.regression.least_squares import LeastSquares
from ident.regression.observation_matrix import Reduction, only_torques, reduce_segments, stack_reductions
from ident.signals.prepared import Prepared, Step

Solve = Callable[[Reduction, Sequence[int]], LeastSquares]
"""The fit of some base columns of a reduced system."""


@dataclass(frozen=True)
class TorqueEstimator:
    """Least squares on the joints' torques.

    Attributes:
        setup: the data.
        solve: the fit of a reduced system.
    """

    setup: Setup
    solve: Solve

    def notes(self, run: Prepared) -> tuple[Step, ...]:
        """Nothing that is not in the list."""
        return ()

    def reduce(self, runs: Sequence[Prepared]) -> Reduction:
        """One factor per joint."""
        return reduce_torques(self.setup.kernel, runs, self.setup.experiment.torques)

    def estimate(self, runs: Sequence[Prepared], plain: Reduction, active: Sequence[int]) -> Estimation:
        """The plain equations' solution."""
        return Estimation(self.setup.kernel, plain, self.solve(plain, active))

    def covariance(self, runs: Sequence[FilteredRun], estimation: Estimation) -> CorrectedCovariance:
        """Delete-block jackknife."""
        return block_jackknife(estimation.kernel, runs, estimation.solution)

    def restricted(self, estimation: Estimation, columns: Sequence[int]) -> LeastSquares:
        """The same fit of fewer columns."""
        return self.solve(estimation.reduction, columns)


def reduce_torques(kernel: RegressorKernel, runs: Sequence[Prepared], torques: Sequence[int]) -> Reduction:
    """The torque equations of all data, those of some motors only."""
    return only_torques(
        stack_reductions([reduce_segments(kernel, run.segments, run.parallel_filter) for run in runs]), torques
    )
