"""Essential parameters: backward elimination of those that the data cannot determine (SR400 .4.3 point 5).

The parameters to drop are selected on the same data, and they are not exactly 0: standard deviations of the submodel
contain neither and are too small. The essential model's error is the full model's error plus the difference between the
two estimates, which is known. Its mean square is therefore estimated by the full model's covariance plus the outer
product of that difference, whatever the selection was (`pruned_covariance`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers.streams import FloatArray
from ident.regression.least_squares import LeastSquares

SIGNIFICANT_RSD = 15.0
"""Relative standard deviation [%] at and above which a parameter is not significant (SR400 .4.3 point 5)."""

F_LEVEL = 0.05
"""Level of the partial F-test that stops the elimination."""


@dataclass(frozen=True)
class Pruned:
    """The essential model.

    Attributes:
        solution: refitted with the essential parameters only.
        dropped: indices of the base columns left out, in the order of their removal.
        stopped_by: why the elimination ended, in words.
    """

    solution: LeastSquares
    dropped: tuple[int, ...]
    stopped_by: str


def relative_std(parameters: FloatArray, std: FloatArray) -> FloatArray:
    """Relative standard deviations [%]; inf where a parameter is 0 or was not estimated."""
    result = np.full(len(parameters), np.inf)
    known = np.isfinite(std) & (parameters != 0)
    result[known] = 100.0 * std[known] / np.abs(parameters[known])
    return result


def pruned_covariance(covariance: FloatArray, difference: FloatArray) -> FloatArray:
    """Mean square error (a, a) of the essential model, in place of a covariance.

    Args:
        covariance: (a, a) of the full model's parameters, corrected.
        difference: (a,) essential minus full values; a dropped parameter's essential value is 0.
    """
    return np.asarray(covariance + np.outer(difference, difference))


def prune(
    solution: LeastSquares,
    inflation: FloatArray,
    effective_rows: float,
    refit: Callable[[tuple[int, ...]], LeastSquares],
    threshold: float = SIGNIFICANT_RSD,
) -> Pruned:
    """Drop the parameter with the largest relative standard deviation, refit, and so on.

    It ends when every parameter left is below the threshold, or when a partial F-test says that the next removal would
    lose fit. With one parameter removed at a time, F = (value / standard deviation)².

    Args:
        solution: of the full model.
        inflation: (b,) corrected over classical standard deviation of the full model, kept for its submodels.
        effective_rows: independent rows, for the test's degrees of freedom.
        refit: solves for a subset of the base columns.
        threshold: [%].
    """
    from scipy.stats import f as f_distribution

    dropped: list[int] = []
    while len(solution.active) > 1:
        std = solution.std * inflation
        rsd = relative_std(solution.parameters, std)
        active = list(solution.active)
        worst = active[int(np.argmax(rsd[active]))]
        if rsd[worst] < threshold:
            return Pruned(solution, tuple(dropped), f"all below {threshold:g} %")
        freedom = max(1.0, effective_rows - len(active))
        statistic = float((solution.parameters[worst] / std[worst]) ** 2)
        limit = float(f_distribution.isf(F_LEVEL, 1, freedom))
        if statistic > limit:
            reason = f"partial F-test: removing one more would lose fit (F = {statistic:.1f} > {limit:.2f})"
            return Pruned(solution, tuple(dropped), reason)
        dropped.append(worst)
        solution = refit(tuple(column for column in active if column != worst))
    return Pruned(solution, tuple(dropped), "one parameter left")
