"""The optimisation problem of an excitation design: variables, cost, constraints."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from daq.motion.trajectories import Motion
from drivers.core.arrays import FloatArray
from ident.excite.criteria import Criterion, RegressorCriterion
from ident.excite.families.moving_joints import Family
from ident.excite.path import Constraint, JointPath
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT


@dataclass(frozen=True)
class ErrorBar:
    """Expected 95 % interval of one parameter."""

    name: str  # of the base parameter
    percent: float  # half of the interval, of the parameter's size [%]


@dataclass(frozen=True)
class ErrorBars:
    """Expected error bars of weighted least squares, as √(A⁻¹)_ii (SR400 eq. 14)."""

    criterion: RegressorCriterion  # with the columns and the weights 1/σ_j of the joints' noise
    names: Sequence[str]  # (b,) of the columns' parameters
    sizes: FloatArray  # (b,) of the parameters: their prior values, at least a share of the largest of its kind
    values: float  # independent values of the noise per joint in the motion

    def worst(self, path: JointPath) -> ErrorBar:
        """The worst of all parameters along one repetition at full speed; infinite where one is not excited."""
        information = self.criterion.information(path) * np.outer(self.sizes, self.sizes)
        try:
            variances = np.diag(np.linalg.inv(information)) / self.values
        except np.linalg.LinAlgError:
            variances = np.full(len(self.names), np.inf)
        variances = np.where(variances > 0.0, variances, np.inf)
        worst = int(np.argmax(variances))
        return ErrorBar(self.names[worst], 100.0 * WITHIN_95_PERCENT * float(np.sqrt(variances[worst])))


@dataclass(frozen=True)
class DesignProblem:
    """Find x that makes a criterion small and uses no limit beyond `allowed`."""

    family: Family  # of the motions that x parametrises
    criterion: Criterion  # the cost
    conditioning: Criterion  # log of the column-normalised condition number of the same columns; for progress
    constraints: Sequence[Constraint]  # the limits
    time: FloatArray  # (N,) grid [s] on which both are evaluated
    allowed: float  # largest limit utilisation, 1 minus a margin for what lies between the grid's points
    error_bars: ErrorBars | None = None  # to expect, for progress; None where no parameters are known beforehand
    # why the check before a motion is played would refuse a motion, in words; empty where it does not
    refusal: Callable[[Motion], str] = lambda _: ""
    by_hull: bool = False  # whether that check also keeps links apart that the constraints leave out

    def path(self, variables: FloatArray) -> JointPath:
        """The motion of x (size,) on the grid."""
        return self.family.path(variables, self.time)

    def cost(self, variables: FloatArray) -> float:
        """The criterion at x (size,), without regard to the limits."""
        return self.criterion.cost(self.path(variables))

    def condition(self, variables: FloatArray) -> float:
        """The condition number at x (size,)."""
        return float(np.exp(self.conditioning.cost(self.path(variables))))

    def smooth_cost(self, variables: FloatArray, sharpness: float) -> tuple[float, FloatArray]:
        """The smooth criterion at x and its derivatives (size,)."""
        cost, gradient = self.criterion.smooth_cost(self.path(variables), sharpness)
        return cost, self.family.pull_back(variables, self.time, gradient)

    @property
    def limits(self) -> tuple[str, ...]:
        """Names (m,) of the limits."""
        return tuple(name for constraint in self.constraints for name in constraint.names)

    def use(self, variables: FloatArray) -> FloatArray:
        """Utilisation (m,) of every limit at x, on the grid."""
        return self.use_along(self.path(variables))

    def use_along(self, path: JointPath) -> FloatArray:
        """Utilisation (m,) of every limit along any motion."""
        return np.concatenate([np.zeros(0), *(constraint.use(path) for constraint in self.constraints)])

    def smooth_use(self, variables: FloatArray, sharpness: float) -> tuple[FloatArray, FloatArray]:
        """Smooth bounds (m,) of the utilisations at x and their derivatives (m, size)."""
        path = self.path(variables)
        uses = [constraint.smooth_use(path, sharpness) for constraint in self.constraints]
        values = np.concatenate([np.zeros(0), *(value for value, _ in uses)])
        rows = [self.family.pull_back(variables, self.time, gradient) for _, gradient in uses]
        return values, np.concatenate([np.zeros((0, self.family.size)), *rows])
