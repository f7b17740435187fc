"""An identification's values with their whole covariance, and the combinations of parameters that they belong to.

A model is printed with standard deviations. Merging it with another one needs more: how the errors hang
together, and which combinations of the arm's standard parameters the values belong to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from drivers.core.arrays import FloatArray
from ident.linear_algebra.triangular import triangular
from ident.regression.jackknife import CorrectedCovariance
from ident.regression.least_squares import LeastSquares, excited_columns
from ident.regression.observation_matrix import Reduction


@dataclass(frozen=True)
class Estimate:
    """Estimated base parameters; a of the b base parameters of the experiment."""

    active: tuple[int, ...]  # (a,) indices of the estimated base parameters
    values: FloatArray  # (a,)
    # (a, a) upper triangular; rootᵀ·root is the inverse of the covariance for white residuals, and weighs the estimate
    # among others
    root: FloatArray
    covariance: FloatArray  # (a, a) corrected for autocorrelated residuals
    # (a, b − a) how much of each base parameter without a value each estimated one absorbs, since the data confound
    # them
    absorbed: FloatArray
    blocks: int  # of the jackknife behind the covariance
    # (a, a) covariance without what changes between runs and for the friction's shapes as estimated, where `covariance`
    # holds these, too; else None
    within: FloatArray | None = None
    shapes: tuple[tuple[str, int], ...] = ()  # kind and motor of the friction's estimated shapes (s,)
    # (s, a + s) of these, as parameters of their sensitivities, with the values and each other
    shape_covariance: FloatArray = field(default_factory=lambda: np.empty((0, 0)))

    def combinations(self, projection: FloatArray) -> FloatArray:
        """Return what the values are values of (a, k), from that (b, k) of all base parameters of the experiment."""
        others = [column for column in range(len(projection)) if column not in self.active]
        return np.asarray(projection[list(self.active)] + self.absorbed @ projection[others])


def estimate_of(reduction: Reduction, solution: LeastSquares, covariance: FloatArray, blocks: int) -> Estimate:
    """The estimate that belongs to a solution.

    Args:
        reduction: the system that was solved.
        solution: of it.
        covariance: (a, a) corrected.
        blocks: of its jackknife.
    """
    active = list(solution.active)
    factor = reduction.stacked(solution.weights)[:, : reduction.column_count]
    count = len(active)
    deviation = np.sqrt(max(solution.residual_sum / (solution.rows - count), np.finfo(float).tiny))
    return Estimate(
        active=solution.active,
        values=solution.parameters[active],
        root=triangular(factor[:, active])[:count] / deviation,
        covariance=covariance,
        absorbed=_absorbed(factor, active, excited_columns(reduction)),
        blocks=blocks,
    )


def jackknifed_estimate(reduction: Reduction, solution: LeastSquares, corrected: CorrectedCovariance) -> Estimate:
    """The same with all that a jackknife says of its errors."""
    return replace(
        estimate_of(reduction, solution, corrected.covariance, corrected.blocks),
        within=corrected.within,
        shapes=corrected.shapes,
        shape_covariance=corrected.shape_covariance,
    )


def _absorbed(factor: FloatArray, active: Sequence[int], excited: Sequence[int]) -> FloatArray:
    """Shares (a, b − a) of the columns that depend on the active ones.

    A column that is excited by itself and yet not active is the friction of a joint at rest: nothing absorbs it.
    """
    others = [column for column in range(factor.shape[1]) if column not in active]
    shares = np.zeros((len(active), len(others)))
    dependent = [place for place, column in enumerate(others) if column not in excited]
    if active and dependent:
        system = factor[:, list(active)]
        lengths = np.linalg.norm(system, axis=0)
        coefficients, *_ = np.linalg.lstsq(
            system / lengths, factor[:, [others[place] for place in dependent]], rcond=None
        )
        significant = np.where(np.abs(coefficients) > RESIDUE_SHARE * np.max(lengths), coefficients, 0.0)
        shares[:, dependent] = significant / lengths[:, None]
    return shares


RESIDUE_SHARE = 1e-9
"""Shares below this fraction of the longest column are rounding residue."""
