"""What every estimator behind `--method` takes and gives.

All work in the base parameters of the dynamic model: whatever has no effect on the torque has none on the energy
either, so they are enough for both kinds of equations. What follows an estimate (error bars of the essential model,
physical consistency, merging, the report) knows an `Estimation`, and not the method.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np
from pydantic.dataclasses import dataclass as stored

from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from ident.model.base_parameters import BaseParameters
from ident.model.regressor import RegressorKernel
from ident.regression.jackknife import CorrectedCovariance, FilteredRun
from ident.regression.least_squares import LeastSquares
from ident.regression.observability import Experiment
from ident.regression.observation_matrix import Reduction
from ident.signals.prepared import Prepared, Step
from ident.stored import Real

Equations = Literal["torque", "energy"]
"""One equation per joint and sample, or one for the whole arm."""


@dataclass(frozen=True, eq=False)
class Setup:
    """What an estimator is built from."""

    kernel: RegressorKernel  # of the base columns
    base: BaseParameters  # the base parameters of the experiment (b)
    experiment: Experiment  # joints that stood still, motors whose torques are used
    robot_file: RobotFile  # of the arm
    runs: tuple[Prepared, ...]  # the prepared data


@stored(frozen=True)
class EstimationLoop:
    """How one loop of an iterative estimator converged."""

    name: str  # what it iterates
    unit: str  # of the values; empty for a relative change
    values: tuple[Real, ...]  # after each iteration
    settled: bool  # whether it converged; else the last iterate was taken
    joint: str = ""  # that the values belong to; empty where they are of the whole arm


@dataclass(frozen=True, eq=False)
class Estimation:
    """What an estimator gives."""

    kernel: RegressorKernel  # of the base columns, with the nonlinear friction parameters that were estimated
    # the system whose least-squares solution the estimate is, one factor per joint to be weighted by
    # `solution.weights`, or one factor of all weighted equations and `solution.weights` of (1,). Of an estimate that is
    # no least squares: the triangular system (root, root·θ̂) of its quadratic approximation.
    reduction: Reduction
    solution: LeastSquares  # of it
    loops: tuple[EstimationLoop, ...] = ()  # convergence, innermost loop first
    # for each segment of all runs, in order, (n, M) by how much each filtered equation counts, 0 to 1; nan where it
    # takes no part. Empty where all that take part count alike.
    weights: tuple[FloatArray, ...] = ()
    passes: int = 1  # over the data, the plain reduction's included
    steps: tuple[Step, ...] = ()  # what the estimate itself did, for the list of steps
    optimum: LeastSquares | None = None  # exact optimum of the same cost, where the estimate is the result of a search
    # Ω (n, n) of the joints' residuals, by which the equations were whitened [(N·m)²]; empty where they were not
    joint_covariance: FloatArray = field(default_factory=lambda: np.empty((0, 0)))


class Estimator(Protocol):
    """One way to estimate base parameters."""

    def notes(self, run: Prepared) -> tuple[Step, ...]:
        """Return its processing of a run before the regression, for the list of steps."""

    def reduce(self, runs: Sequence[Prepared]) -> Reduction:
        """The plain equations of all data: they tell the excited columns and the condition."""

    def estimate(self, runs: Sequence[Prepared], plain: Reduction, active: Sequence[int]) -> Estimation:
        """The estimate of the active base columns.

        Raises:
            IdentificationError: there is no solution.
        """

    def covariance(self, runs: Sequence[FilteredRun], estimation: Estimation) -> CorrectedCovariance:
        """Covariance of the active parameters for autocorrelated residuals, by the delete-block jackknife."""

    def restricted(self, estimation: Estimation, columns: Sequence[int]) -> LeastSquares:
        """The same system solved for fewer base columns, as for the essential model."""
