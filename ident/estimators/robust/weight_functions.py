"""How much an equation counts, by its normalised residual z: hard rejection, Huber, Tukey.

Least squares with weights w(z) solves Σ ψ(z)·x = 0 with ψ = z·w. The thresholds lose 5 % of efficiency on normal
residuals. AUBO takes a "T-class hard weight" from Han et al.: read here as hard rejection, weight 1 up to a quantile of
Student's t distribution and 0 beyond; at 99.5 % of many samples it is 2.81, that of Talwar's hard weights 2.795.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from drivers.core.arrays import FloatArray

WeightName = Literal["hard", "huber", "tukey"]

HARD_LEVEL = 0.005
"""Share of normal residuals that hard weights reject."""

HUBER_THRESHOLD = 1.345
TUKEY_THRESHOLD = 4.685

SOFTENED = 0.5
"""Half the width [σ] over which hard weights fall where it matters how they move with the data."""

_INTEGRATION = np.linspace(-12.0, 12.0, 48_001)
"""Normal residuals at which expectations are summed."""


@dataclass(frozen=True)
class WeightFunction:
    """A weight function with its threshold."""

    name: WeightName  # of the function
    threshold: float  # of |z|; beyond it a residual counts less, or not at all

    def __call__(self, residual: FloatArray) -> FloatArray:
        """Weights, 0 to 1, of normalised residuals; same shape."""
        size = np.abs(residual) / self.threshold
        if self.name == "hard":
            return (size <= 1.0).astype(np.float64)
        if self.name == "huber":
            return np.asarray(1.0 / np.maximum(size, 1.0))
        return np.asarray(np.square(np.clip(1.0 - size**2, 0.0, None)))

    def loss(self, residual: FloatArray) -> FloatArray:
        """2·ρ of normalised residuals, ρ′ = ψ: what these weights minimise, z² where small; same shape."""
        size = np.abs(residual) / self.threshold
        if self.name == "hard":
            losses = np.minimum(size, 1.0) ** 2
        elif self.name == "huber":
            losses = np.where(size <= 1.0, size**2, 2.0 * size - 1.0)
        else:
            losses = (1.0 - np.clip(1.0 - size**2, 0.0, None) ** 3) / 3.0
        return np.asarray(self.threshold**2 * losses)

    @property
    def variance(self) -> float:
        """E[w·z²]/E[w] of normal residuals: what their weighted variance is too small by."""
        weights = self(_INTEGRATION)
        return _mean(weights * _INTEGRATION**2) / _mean(weights)

    def slope(self, residual: FloatArray) -> FloatArray:
        """ψ′ of normalised residuals: by how much an equation holds the estimate against its data; same shape.

        Hard weights fall over `SOFTENED` to both sides of the threshold here: an equation near it that moves is
        rejected, or no longer.
        """
        size = np.abs(residual)
        if self.name == "hard":
            weight = np.clip((self.threshold + SOFTENED - size) / (2.0 * SOFTENED), 0.0, 1.0)
            falls = np.abs(size - self.threshold) < SOFTENED
            return np.asarray(weight - np.where(falls, size / (2.0 * SOFTENED), 0.0))
        if self.name == "huber":
            return (size <= self.threshold).astype(np.float64)
        square = np.square(size / self.threshold)
        return np.where(square < 1.0, (1.0 - square) * (1.0 - 5.0 * square), 0.0)


def weight_function(name: WeightName, freedom: float) -> WeightFunction:
    """The function of a name for residuals of so many degrees of freedom."""
    from scipy.special import stdtrit

    if name == "hard":
        return WeightFunction(name, -float(stdtrit(max(1.0, freedom), 0.5 * HARD_LEVEL)))
    return WeightFunction(name, HUBER_THRESHOLD if name == "huber" else TUKEY_THRESHOLD)


def _mean(values: FloatArray) -> float:
    """Expectation over normal residuals of a function given at `_INTEGRATION`."""
    density = np.exp(-0.5 * _INTEGRATION**2)
    return float(values @ density / density.sum())
