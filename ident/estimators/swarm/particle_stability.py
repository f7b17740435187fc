"""Whether a particle comes to rest: the stability condition of ROCR6 section 3.4, made computable.

With its own best point p and the best of all s fixed, a particle follows x' = (1 + W − θ)·x − W·x₋ + θ1·p + θ2·s,
θ = θ1 + θ2 = c1·r1 + c2·r2: eq. 17, whose lower right entry must be 1 − θ. The paper asks for ‖C(t)‖ < 1, which no W
and θ fulfil at every t; W and θ are random and independent, so that mean and variance follow linear recursions. Their
spectral radii decide: below 1 the particle comes to rest (Poli 2009, IEEE Trans. Evolutionary Computation 13).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from drivers.core.arrays import FloatArray


class InertiaWeight(Protocol):
    """A distribution of inertia weights."""

    @property
    def mean(self) -> float:
        """Mean of W."""

    @property
    def mean_square(self) -> float:
        """Mean of W²."""

    def draw(self, generator: np.random.Generator, count: int) -> FloatArray:
        """(count, 1) weights."""


@dataclass(frozen=True)
class Stability:
    """Growth per generation of a particle whose best points do not change.

    Attributes:
        mean: spectral radius of the mean position's recursion.
        variance: of the variance's.
    """

    mean: float
    variance: float

    @property
    def remark(self) -> str:
        """What follows from it; empty where both settle."""
        if self.mean >= 1.0:
            return f"the mean position grows {self.mean:.3g}-fold per generation; only the clamps bound the particles"
        if self.variance >= 1.0:
            return f"the positions' variance grows {self.variance:.3g}-fold per generation; the swarm does not settle"
        return ""


def particle_stability(weight: InertiaWeight, cognitive: float, social: float) -> Stability:
    """Stability of a particle swarm's settings.

    Args:
        weight: of inertia.
        cognitive: c1.
        social: c2.
    """
    w, ww = weight.mean, weight.mean_square
    theta = 0.5 * (cognitive + social)
    variance = (cognitive**2 + social**2) / 12.0
    drift = 1.0 + w - theta
    mean = np.array([[drift, -w], [1.0, 0.0]])
    # E[l²] and E[l·W] of l = 1 + W − θ.
    square = drift**2 + (ww - w**2) + variance
    product = (1.0 - theta) * w + ww
    moments = np.array([[square, -2.0 * product, ww], [drift, -w, 0.0], [1.0, 0.0, 0.0]])
    return Stability(_radius(mean), _radius(moments))


def _radius(matrix: FloatArray) -> float:
    return float(np.max(np.abs(np.linalg.eigvals(matrix))))
