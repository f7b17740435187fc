"""Normal equations of a recording at its instants, with every torque in every joint's rows, block by block."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from ident.assessment.instants import BLOCKS, Columns, Instants
from ident.linear_algebra.inequalities import least_squares_within

LEAST_ERROR = 0.01
"""Relative error of a joint below which a better fit says nothing more."""

RIDGE = 1e-9
"""Added to the scaled normal matrix's diagonal: columns that the data do not excite stay near 0."""

FREE_ITERATIONS, BOUND_ITERATIONS = 5, 3
"""Iterations of the joints' weights without and with conditions."""


@dataclass(frozen=True, eq=False)
class HypothesisFit:
    """A hypothesis with its best parameters."""

    parameters: FloatArray  # (a,) of the active columns
    relative: FloatArray  # (n,) sum of squared residuals over that of the torque, of each joint
    level: float  # Σ log(relative) over the joints: lower by 2 log 2 where one joint's error is halved


@dataclass(frozen=True, eq=False)
class Equations:
    """K blocks of n joints' equations with a columns."""

    gram: FloatArray  # (K, n, a, a) WᵀW of joint j's rows
    score: FloatArray  # (K, n, n, a) Wᵀτ_k of joint j's rows and torque k
    power: FloatArray  # (K, n, n) Σ τ_k² over joint j's equations
    rows: FloatArray  # (K, n) how many there are; 0 for torques that are not used

    def fit(
        self, columns: Columns, conditions: FloatArray | None = None, blocks: Sequence[int] | None = None
    ) -> HypothesisFit | None:
        """Weighted least squares with these torques, under G·x ≥ 0 where conditions (c, a) are given.

        Args:
            columns: torques taken for the joints.
            conditions: G.
            blocks: that are fitted to; all where None.

        Returns:
            The fit; None where the conditions cannot be met.
        """
        chosen = list(range(len(self.rows))) if blocks is None else list(blocks)
        gram, score, power, rows = self._of(columns, chosen)
        used = rows > 0
        relative = np.ones(len(rows))
        parameters = np.zeros(gram.shape[-1])
        for _ in range(FREE_ITERATIONS if conditions is None else BOUND_ITERATIONS):
            variance = power * (relative + LEAST_ERROR**2)
            weight = np.where(used & (variance > 0), rows / np.where(variance > 0, variance, 1.0), 0.0)
            matrix = np.tensordot(weight, gram, 1)
            scale = np.sqrt(np.diag(matrix))
            scale[scale == 0.0] = 1.0
            scaled = matrix / np.outer(scale, scale) + RIDGE * np.eye(len(scale))
            factor = np.linalg.cholesky(scaled).T
            target: FloatArray = np.asarray(np.linalg.solve(factor.T, weight @ score / scale), dtype=np.float64)
            none = np.empty((0, len(scale)))
            solved = least_squares_within(factor, target, none if conditions is None else conditions / scale)
            if solved is None:
                return None
            parameters = solved / scale
            relative = _relative(gram, score, power, parameters)
        return HypothesisFit(parameters, relative, float(np.sum(np.log(relative + LEAST_ERROR**2)[used])))

    def levels(self, columns: Columns, parameters: FloatArray, blocks: Sequence[int]) -> FloatArray:
        """(n,) log of the relative squared residuals of some blocks, 0 where a joint has no rows there."""
        gram, score, power, rows = self._of(columns, blocks)
        relative = _relative(gram, score, power, parameters)
        return np.where(rows > 0, np.log(relative + LEAST_ERROR**2), 0.0)

    def of(self, blocks: Sequence[int], columns: Columns) -> Equations:
        """Some blocks, with the torques taken so that each joint's is in its own place."""
        factor, order = np.array(columns.factor), list(columns.order)
        score = self.score[blocks][:, :, order] * factor[:, None]
        return Equations(self.gram[blocks], score, self.power[blocks][:, :, order] * factor**2, self.rows[blocks])

    def beside(self, other: Equations) -> Equations:
        """These blocks and those of others."""
        pairs = ((getattr(self, name), getattr(other, name)) for name in ("gram", "score", "power", "rows"))
        return Equations(*(np.concatenate(pair) for pair in pairs))

    def _of(self, columns: Columns, blocks: Sequence[int]) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        factor, joints = np.array(columns.factor), np.arange(self.rows.shape[1])
        score = self.score[blocks][:, joints, list(columns.order)].sum(axis=0) * factor[:, None]
        power = self.power[blocks][:, joints, list(columns.order)].sum(axis=0) * factor**2
        return self.gram[blocks].sum(axis=0), score, power, self.rows[blocks].sum(axis=0)


def _relative(gram: FloatArray, score: FloatArray, power: FloatArray, parameters: FloatArray) -> FloatArray:
    """(n,) sums of squared residuals over those of the torques."""
    squares = power - 2.0 * score @ parameters + np.einsum("a,nab,b->n", parameters, gram, parameters)
    return np.asarray(np.maximum(squares, 0.0) / np.where(power > 0, power, 1.0))


def equations(regressor: FloatArray, instants: Instants, torques: Sequence[int]) -> Equations:
    """Sum up the equations of the joints whose `torques` count, for a regressor (n, a, N) of the active columns."""
    count, width = regressor.shape[:2]
    gram, score = np.zeros((BLOCKS, count, width, width)), np.zeros((BLOCKS, count, count, width))
    power, rows = np.zeros((BLOCKS, count, count)), np.zeros((BLOCKS, count))
    for joint in torques:
        for block in range(BLOCKS):
            chosen = instants.counted[joint] & (instants.block == block)
            own, torque = regressor[joint][:, chosen], instants.torque[:, chosen]
            gram[block, joint] = own @ own.T
            score[block, joint] = torque @ own.T
            power[block, joint] = np.sum(torque**2, axis=1)
            rows[block, joint] = chosen.sum()
    return Equations(gram, score, power, rows)
