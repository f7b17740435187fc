"""Costs without a closed solution: robust losses, and a penalty for bodies that cannot exist."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from drivers.streams import FloatArray
from ident.estimators.feasible.pseudo_inertia import pseudo_inertia
from ident.estimators.swarm.minimisation import Cost

ROWS = 200_000
"""Residuals that are held at once."""

HUBER, TUKEY = 1.345, 4.685
"""Thresholds in standard deviations, of 95 % efficiency for normal residuals."""


@dataclass(frozen=True, eq=False)
class RobustCost:
    """Mean loss of the normalised residuals of a linear model; needs the rows, not only their factor.

    Attributes:
        rows: W (N, d).
        torque: (N,).
        scale: (N,) standard deviation of each residual without its outliers.
        loss: "absolute" |u|, "huber", or "tukey", which is bounded and therefore has several minima.
    """

    rows: FloatArray
    torque: FloatArray
    scale: FloatArray
    loss: Literal["absolute", "huber", "tukey"] = "huber"

    def __call__(self, points: FloatArray) -> FloatArray:
        """Costs (P,) of points (P, d)."""
        total = np.zeros(len(points))
        length = max(1, ROWS // len(points))
        for start in range(0, len(self.torque), length):
            part = slice(start, start + length)
            u = np.abs((points @ self.rows[part].T - self.torque[part]) / self.scale[part])
            total += self._losses(u).sum(axis=1)
        return np.asarray(total / len(self.torque))

    def _losses(self, u: FloatArray) -> FloatArray:
        if self.loss == "absolute":
            return u
        if self.loss == "huber":
            return np.where(u <= HUBER, 0.5 * u**2, HUBER * u - 0.5 * HUBER**2)
        return np.asarray(TUKEY**2 / 6.0 * (1.0 - (1.0 - np.minimum(u / TUKEY, 1.0) ** 2) ** 3))


@dataclass(frozen=True, eq=False)
class FeasibilityPenalty:
    """Σ over links of the negative eigenvalues of their pseudo-inertia, relative to a reference body's; 0 if feasible.

    Attributes:
        inverse_roots: (k, 4, 4) L⁻¹ of each link's reference pseudo-inertia L·Lᵀ.
    """

    inverse_roots: FloatArray

    @classmethod
    def of(cls, references: FloatArray) -> FeasibilityPenalty:
        """Relative to links (k, 10) of standard parameters that can exist."""
        return cls(np.linalg.inv(np.linalg.cholesky(pseudo_inertia(references))))

    def __call__(self, links: FloatArray) -> FloatArray:
        """Penalties (P,) of links (P, k, 10)."""
        relative = self.inverse_roots @ pseudo_inertia(links) @ np.swapaxes(self.inverse_roots, -1, -2)
        return np.asarray(-np.minimum(np.linalg.eigvalsh(relative), 0.0).sum(axis=(-1, -2)))


@dataclass(frozen=True, eq=False)
class PenalisedCost:
    """A cost of standard parameters that rises with what no body can have.

    Attributes:
        cost: of standard parameters (P, p).
        penalty: of their links.
        weight: cost of a violation as large as the reference body.
    """

    cost: Cost
    penalty: FeasibilityPenalty
    weight: float

    def __call__(self, points: FloatArray) -> FloatArray:
        """Costs (P,) of standard parameters (P, p), the links' first."""
        links = len(self.penalty.inverse_roots)
        bodies = points[:, : 10 * links].reshape(len(points), links, 10)
        return self.cost(points) + self.weight * self.penalty(bodies)
