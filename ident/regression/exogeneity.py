"""Durbin, Wu and Hausman's comparison of instrumental variables with least squares (Hausman, Econometrica 46, 1978).

H0: W is not correlated with the errors of τ. Then both estimates have the same limit, and their difference is noise of
a covariance that the delete-block jackknife of the difference gives. A quadratic form in it would need many more blocks
than parameters; the largest of the single differences needs none (Bonferroni).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ident.regression.comparison import TorqueSeries
from ident.regression.jackknife import jackknife_covariance, motion_blocks
from ident.regression.least_squares import LeastSquares
from ident.regression.moment_equations import MomentRows, moment_moves

Source = Iterable[MomentRows]


@dataclass(frozen=True)
class ExogeneityTest:
    """The largest difference of two estimates.

    Attributes:
        column: base column of the parameter.
        ratio: its difference in the difference's own standard deviations.
        p_value: probability of a larger one under H0, of any parameter.
    """

    column: int
    ratio: float
    p_value: float


def exogeneity_test(
    series: Sequence[TorqueSeries],
    instrumental: tuple[LeastSquares, Sequence[Source]],
    plain: tuple[LeastSquares, Sequence[Source]],
) -> ExogeneityTest:
    """Compare two solutions of the same active columns.

    Args:
        series: measured and predicted torques of every segment.
        instrumental: the solution by instruments, and its equations of every segment.
        plain: that of least squares, and its.

    Raises:
        IdentificationError: the instruments do not follow the regressor.
    """
    from scipy.stats import t as student

    blocks = motion_blocks(series)
    one, other = (moment_moves(blocks, sources, solution) for solution, sources in (instrumental, plain))
    active = list(instrumental[0].active)
    difference = np.abs(instrumental[0].parameters - plain[0].parameters)[active]
    deviation = np.sqrt(np.diag(jackknife_covariance(one - other)))
    ratios = difference / np.maximum(deviation, np.finfo(float).tiny)
    worst = int(np.argmax(ratios))
    p_value = min(1.0, 2.0 * len(active) * float(student.sf(ratios[worst], len(one) - 1)))
    return ExogeneityTest(active[worst], float(ratios[worst]), p_value)
