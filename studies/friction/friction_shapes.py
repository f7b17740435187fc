"""Nonlinear friction with the linear part eliminated: only the shapes are searched (variable projection).

For given shapes (Stribeck velocity, exponent, bristle stiffness) the torque is linear in all other parameters, so that
they follow by least squares: a population searches 2 or 3 variables per joint instead of dozens.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray

Columns = Callable[[FloatArray], FloatArray]
"""Columns (P, N, k) of the observation matrix for shapes (P, s)."""

_DEPENDENT = 1e-10
"""Eigenvalues of the normalised Gram matrix below this share of the largest are rounding."""


@dataclass(frozen=True, eq=False)
class ShapeCost:
    """‖τ − W·x − F(shapes)·f‖₂, least over x and f.

    Attributes:
        basis: (N, b) orthonormal basis of the columns W that no shape changes.
        torque: (N,) without its part in that basis.
        columns: F.
    """

    basis: FloatArray
    torque: FloatArray
    columns: Columns

    @classmethod
    def of(cls, fixed: FloatArray, torque: FloatArray, columns: Columns) -> ShapeCost:
        """Make the problem of fixed columns (N, b), a torque (N,), and columns that depend on the shapes."""
        basis = np.linalg.qr(fixed)[0]
        return cls(basis, torque - basis @ (basis.T @ torque), columns)

    def __call__(self, points: FloatArray) -> FloatArray:
        """Costs (P,) of shapes (P, s)."""
        free = self._free_columns(points)
        gram = np.swapaxes(free, -1, -2) @ free
        score = np.einsum("pnk,n->pk", free, self.torque)
        lengths = np.sqrt(np.einsum("pkk->pk", gram))
        lengths = np.where(lengths > 0.0, lengths, 1.0)
        gram /= lengths[:, :, None] * lengths[:, None, :]
        score /= lengths
        undefined = ~np.all(np.isfinite(gram), axis=(1, 2))
        gram[undefined] = np.eye(gram.shape[1])
        explained = np.einsum("pk,pkl,pl->p", score, np.linalg.pinv(gram, rcond=_DEPENDENT, hermitian=True), score)
        costs = np.sqrt(np.maximum(float(self.torque @ self.torque) - explained, 0.0))
        costs[undefined] = np.nan
        return np.asarray(costs)

    def residual(self, point: FloatArray) -> FloatArray:
        """Residual (N,) of shapes (s,): what a gradient method works with."""
        return np.asarray(self.residuals(point[None, :])[0])

    def residuals(self, points: FloatArray) -> FloatArray:
        """Residuals (P, N) of shapes (P, s)."""
        fits = [free @ np.linalg.lstsq(free, self.torque, rcond=None)[0] for free in self._free_columns(points)]
        return np.asarray(self.torque - np.array(fits))

    def coefficients(self, point: FloatArray) -> FloatArray:
        """Linear coefficients f (k,) that belong to shapes (s,)."""
        return np.asarray(np.linalg.lstsq(self._free_columns(point[None, :])[0], self.torque, rcond=None)[0])

    def _free_columns(self, points: FloatArray) -> FloatArray:
        with np.errstate(over="ignore", invalid="ignore"):  # shapes may overflow: such costs are undefined
            columns = self.columns(points)
            return np.asarray(columns - self.basis @ (self.basis.T @ columns))


def stribeck_columns(velocity: FloatArray) -> Columns:
    """Power law and Stribeck of one joint: sign·|q̇|^α and sign·exp(−|q̇/v_s|^δ) for shapes α, v_s, δ.

    AUBO eq. 6's velocity term, with the Stribeck term of Armstrong-Hélouvry; sign, offset and so on are fixed columns.

    Args:
        velocity: (N,) [rad/s].
    """
    size, sign = np.abs(velocity), np.sign(velocity)

    def columns(shapes: FloatArray) -> FloatArray:
        exponent, stribeck, order = (shapes[:, index, None] for index in range(3))
        return np.stack([sign * size**exponent, sign * np.exp(-((size / stribeck) ** order))], axis=-1)

    return columns


def lugre_columns(velocity: FloatArray, rate: float) -> Columns:
    """LuGre of one joint (Canudas de Wit et al. 1995): the bristles' deflection z and ż for shapes κ, ρ, v_s.

    ż = κ·(q̇ − |q̇|·z/g), g = 1 + (ρ − 1)·exp(−(q̇/v_s)²): z is 1 in Coulomb friction, ρ is static over Coulomb
    friction, κ [1/rad] stiffness over Coulomb friction. Viscous friction is a fixed column. Each step is solved exactly
    for a constant velocity, so that no stiffness is too high.

    Args:
        velocity: (N,) [rad/s], from rest or from a state that is soon forgotten.
        rate: of the samples [Hz].
    """

    def columns(shapes: FloatArray) -> FloatArray:
        stiffness, static, stribeck = (shapes[:, index] for index in range(3))
        bristles = np.zeros((len(velocity), len(shapes)))
        z = np.zeros(len(shapes))
        for index, v in enumerate(velocity):
            bristles[index] = z
            if v:
                steady = np.sign(v) * (1.0 + (static - 1.0) * np.exp(-((v / stribeck) ** 2)))
                z = steady + (z - steady) * np.exp(-stiffness * np.abs(v) / (np.abs(steady) * rate))
        change = np.gradient(bristles, 1.0 / rate, axis=0)
        return np.ascontiguousarray(np.stack([bristles, change], axis=-1).swapaxes(0, 1))

    return columns
