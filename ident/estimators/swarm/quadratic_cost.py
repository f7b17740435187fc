"""The cost of a linear model, ‖W·x − τ‖₂ (UP6 eq. 10; ROCR6 eq. 9), on the triangular factor of [W τ].

A population of P points costs one product of (P, d) with (d, d), however long the recording was. Least squares
minimises it exactly, which every other method is measured by.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from ident.estimators.swarm.box import SearchBox
from ident.regression.observation_matrix import Reduction


@dataclass(frozen=True, eq=False)
class QuadraticCost:
    """‖W·x − τ‖₂ = √(‖R·x − z‖² + ρ²).

    Attributes:
        root: R (r, d).
        target: z (r,).
        rest: ρ², the sum of squares that no x lowers.
    """

    root: FloatArray
    target: FloatArray
    rest: float = 0.0

    @classmethod
    def of_reduction(
        cls, reduction: Reduction, active: Sequence[int], weights: FloatArray | None = None
    ) -> QuadraticCost:
        """Build the cost of a reduced system's active base columns, rows times joints' weights (n,), 1 where None."""
        factor = reduction.stacked(weights, active)
        count = len(active)
        return cls(factor[:count, :count], factor[:count, count], float(factor[count, count] ** 2))

    def __call__(self, points: FloatArray) -> FloatArray:
        """Costs (P,) of points (P, d)."""
        residual = points @ self.root.T
        residual -= self.target
        return np.asarray(np.sqrt(np.einsum("pr,pr->p", residual, residual) + self.rest))

    def least(self) -> FloatArray:
        """The exact optimum x (d,)."""
        lengths = np.linalg.norm(self.root, axis=0)
        lengths = np.where(lengths > 0.0, lengths, 1.0)
        return np.asarray(np.linalg.lstsq(self.root / lengths, self.target, rcond=None)[0] / lengths)

    def least_within(self, box: SearchBox) -> FloatArray:
        """The exact optimum x (d,) of a box."""
        from scipy.optimize import lsq_linear

        # Variables scaled to the box: the solver's tolerances are absolute.
        scaled = lsq_linear(
            self.root * box.width,
            self.target - self.root @ box.lower,
            bounds=(np.zeros(box.size), np.ones(box.size)),
            method="bvls",
            tol=1e-14,
            max_iter=100 * box.size,
        )
        return box.clip(box.lower + box.width * scaled.x)

    def cost(self, point: FloatArray) -> float:
        """At one point (d,)."""
        return float(self(point[None, :])[0])
