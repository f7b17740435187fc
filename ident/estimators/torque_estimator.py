"""Least squares on the joints' torque equations, one factor per joint (SR400 eq. 13).

What follows an estimate solves reduced systems: with fewer columns, with physical conditions. An estimate θ̂ that is no
least squares of these equations, of (approximate) inverse covariance RᵀR, is therefore written as the system R·θ =
R·θ̂.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.core.arrays import FloatArray
from ident.estimators.estimator import Estimation, Setup
from ident.linear_algebra.triangular import triangular
from ident.model.regressor import RegressorKernel
from ident.regression.jackknife import CorrectedCovariance, FilteredRun, block_jackknife
from ident.regression.least_squares import LeastSquares, residual_deviations, solve_weighted
from ident.regression.observation_matrix import JointFactor, Reduction, only_torques, reduce_segments, stack_reductions
from ident.signals.prepared import Prepared, Step

Solve = Callable[[Reduction, Sequence[int]], LeastSquares]
"""The fit of some base columns of a reduced system."""


@dataclass(frozen=True)
class TorqueEstimator:
    """Least squares on the joints' torques."""

    setup: Setup  # the data
    solve: Solve  # the fit of a reduced system

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


@dataclass(frozen=True)
class SystemEstimator(TorqueEstimator):
    """An estimate that is the solution of a system in the place of the torque equations."""

    def restricted(self, estimation: Estimation, columns: Sequence[int]) -> LeastSquares:
        """The same system solved for fewer base columns."""
        full = estimation.solution
        solved = solve_weighted(estimation.reduction, columns, full.weights, full.method)
        return replace(solved, joint_std=full.joint_std)


def reduce_torques(kernel: RegressorKernel, runs: Sequence[Prepared], torques: Sequence[int]) -> Reduction:
    """The torque equations of all data, those of some motors only."""
    return only_torques(
        stack_reductions([reduce_segments(kernel, run.segments, run.parallel_filter) for run in runs]), torques
    )


@dataclass(frozen=True, eq=False)
class TriangularSystem:
    """A system of all joints' equations, weighted, with its solution."""

    reduction: Reduction  # the whole system stands with the first joint that has rows
    solution: LeastSquares  # its least squares, with the joints' weights and residuals


def triangular_system(
    plain: Reduction, system: FloatArray, weights: FloatArray, active: Sequence[int], method: str, iterations: int = 1
) -> TriangularSystem:
    """Solve a system that takes the place of the plain equations.

    Args:
        plain: the torque equations, which the residuals are those of.
        system: (k, b + 1) of base columns and right-hand side, weighted.
        weights: (n,) of the joints' rows in it.
        active: base columns.
        method: name.
        iterations: that led to it.

    Raises:
        IdentificationError: columns that depend on each other.
    """
    first = int(np.flatnonzero(weights > 0)[0])

    def joints(factor: FloatArray) -> tuple[JointFactor, ...]:
        everything = tuple(range(plain.column_count))
        return tuple(
            JointFactor(everything, factor / weights[first] if motor == first else factor[:0], joint.rows)
            for motor, joint in enumerate(plain.joints)
        )

    factor = triangular(system)
    factor[-1] = 0.0
    exact = solve_weighted(replace(plain, joints=joints(factor)), active, weights, method)
    factor[-1, -1] = np.sqrt(np.sum(weights**2 * plain.residual_sums(exact.parameters)))
    reduction = replace(plain, joints=joints(factor))
    solution = solve_weighted(reduction, active, weights, method, iterations)
    deviations = residual_deviations(plain, solution.parameters, len(solution.active))
    return TriangularSystem(reduction, replace(solution, joint_std=deviations))
