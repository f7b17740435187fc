"""Whether a difference of identified values is statistically significant, its covariance coming from few blocks."""

from __future__ import annotations

import numpy as np
from pydantic import computed_field
from pydantic.dataclasses import dataclass as stored

from drivers.core.arrays import FloatArray
from ident.model.load import INDEPENDENT

WITHIN_95_PERCENT = 1.96
"""95 % of a normal distribution lie within so many standard deviations of its mean."""

LEVEL = 0.01
"""Significance level: a p-value below it rejects."""

FEWEST_EXTRA_BLOCKS = 5
"""The test needs so many blocks more than it has degrees of freedom."""


@stored(frozen=True)
class SignificanceTest:
    """A comparison of two sets of values that should differ by noise only."""

    statistic: float  # χ² (Hotelling's T²), the squared difference in its own standard deviations
    freedom: int  # its degrees of freedom
    p_value: float  # probability of a larger statistic from noise alone

    @computed_field  # type: ignore[prop-decorator]
    @property
    def passed(self) -> bool:
        """Return whether the difference is not statistically significant."""
        return self.p_value >= LEVEL

    @property
    def p_text(self) -> str:
        """The p-value in print."""
        return p_text(self.p_value)


def p_text(p_value: float) -> str:
    """A p-value in print."""
    return "p < 0.0001" if p_value < 1e-4 else f"p = {p_value:.2g}"


def chi_square_test(
    difference: FloatArray, covariance: FloatArray, blocks: int, explained_by: FloatArray | None = None
) -> SignificanceTest | None:
    """Test whether a difference is significant, once its component in the span of some columns has been removed.

    Args:
        difference: (m,).
        covariance: (m, m) of it, from a jackknife over `blocks` blocks.
        blocks: B.
        explained_by: (m, k) columns whose multiples are allowed; none where None.

    Returns:
        None where nothing is left to test or the blocks are too few for it.
    """
    from scipy.special import fdtrc

    # Scaled first: parameters of links and wrist differ by orders of magnitude.
    scale = np.sqrt(np.diag(covariance))
    if len(difference) == 0 or not np.all(np.isfinite(scale) & (scale > 0)):
        return None
    left, spread = difference / scale, covariance / np.outer(scale, scale)
    if explained_by is not None:
        columns = explained_by / scale[:, None]
        lengths = np.linalg.norm(columns, axis=0)
        columns = columns[:, lengths > 0] / lengths[lengths > 0]
        basis, singular, _ = np.linalg.svd(columns)
        free = basis[:, int(np.count_nonzero(singular > INDEPENDENT * singular.max(initial=0.0))) :]
        left, spread = free.T @ left, free.T @ spread @ free
    freedom = len(left)
    if freedom == 0 or blocks < freedom + FEWEST_EXTRA_BLOCKS:
        return None
    statistic = float(left @ np.linalg.solve(spread, left))
    ratio = statistic * (blocks - freedom) / (freedom * (blocks - 1))
    return SignificanceTest(statistic, freedom, float(fdtrc(freedom, blocks - freedom, max(ratio, 0.0))))
