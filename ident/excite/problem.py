"""The optimisation problem of an excitation design: variables, cost, constraints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.streams import FloatArray
from ident.excite.criteria import Criterion
from ident.excite.path import Constraint, Family, Path

PENALTY = 100.0
"""What a population method pays for a limit that is exceeded by its whole size; costs are logarithms."""


@dataclass(frozen=True)
class Problem:
    """Find x that makes a criterion small and uses no limit beyond `allowed`.

    Attributes:
        family: what x stands for.
        criterion: the cost.
        conditioning: log of the condition number, columns scaled, of what the criterion is about; for progress.
        constraints: the limits.
        time: (N,) grid [s] on which both are evaluated.
        allowed: largest use of a limit, 1 minus a margin for what lies between the grid's points.
    """

    family: Family
    criterion: Criterion
    conditioning: Criterion
    constraints: Sequence[Constraint]
    time: FloatArray
    allowed: float

    def path(self, variables: FloatArray) -> Path:
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
        """What each of the m uses is a use of."""
        return tuple(name for constraint in self.constraints for name in constraint.names)

    def use(self, variables: FloatArray) -> FloatArray:
        """Use (m,) of every limit at x, on the grid."""
        return self.use_along(self.path(variables))

    def use_along(self, path: Path) -> FloatArray:
        """Use (m,) of every limit along any motion."""
        return np.concatenate([np.zeros(0), *(constraint.use(path) for constraint in self.constraints)])

    def smooth_use(self, variables: FloatArray, sharpness: float) -> tuple[FloatArray, FloatArray]:
        """Smooth bounds (m,) of the uses at x and their derivatives (m, size)."""
        path = self.path(variables)
        parts = [constraint.smooth_use(path, sharpness) for constraint in self.constraints]
        values = np.concatenate([np.zeros(0), *(value for value, _ in parts)])
        rows = [self.family.pull_back(variables, self.time, gradient) for _, gradient in parts]
        return values, np.concatenate([np.zeros((0, self.family.size)), *rows])

    def costs(self, population: FloatArray) -> FloatArray:
        """Costs (P,) of candidates (P, size), each with `PENALTY` for what it exceeds: for population methods."""
        return np.array(
            [self.cost(x) + PENALTY * np.maximum(self.use(x) - self.allowed, 0.0).sum() for x in population]
        )
