"""Essential parameters: backward elimination of those that the data cannot determine.

SR400 (.4.3 point 5) eliminates every parameter whose relative standard deviation is 15 % or more. It does not say
whether at once or one at a time; here one at a time, the worst first, with a new estimate after each, since parameters
that share a column become surer without one another. AUBO (Table II) eliminates by the F-statistic.

The parameters to drop are selected on the same data, and they are not exactly 0: standard deviations of the submodel
contain neither and are too small. The essential model's error is the full model's error plus the difference between the
two estimates, which is known. Its mean square is therefore estimated by the full model's covariance plus the outer
product of that difference, whatever the selection was (`pruned_covariance`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from ident.regression.least_squares import LeastSquares
from ident.regression.options import SIGNIFICANT_RSD, EssentialOptions, EssentialRule

F_LEVEL = 0.05
"""Level of the partial F-test (AUBO .IV: threshold 3.85). One parameter passes it at a relative deviation of 51 %."""


@dataclass(frozen=True)
class Pruned:
    """The essential model."""

    solution: LeastSquares  # refitted with the essential parameters only
    dropped: tuple[int, ...]  # indices of the base columns left out, in the order of their removal
    stopped_by: str  # why the elimination ended, in words


def relative_std(parameters: FloatArray, std: FloatArray) -> FloatArray:
    """Relative standard deviations [%]; inf where a parameter is 0 or was not estimated."""
    result = np.full(len(parameters), np.inf)
    finite = np.isfinite(std) & (parameters != 0)
    result[finite] = 100.0 * std[finite] / np.abs(parameters[finite])
    return result


def pruned_covariance(covariance: FloatArray, difference: FloatArray) -> FloatArray:
    """Mean square error (a, a) of the essential model, in place of a covariance.

    Args:
        covariance: (a, a) of the full model's parameters, corrected.
        difference: (a,) essential minus full values; a dropped parameter's essential value is 0.
    """
    return np.asarray(covariance + np.outer(difference, difference))


def partial_f(parameters: FloatArray, std: FloatArray) -> FloatArray:
    """Partial F of each parameter: (value / standard deviation)², of one degree of freedom (AUBO Table II).

    It is the loss of fit when this parameter alone is removed and all others are refitted, in residual variances. With
    corrected standard deviations it counts what is independent of autocorrelated residuals. NaN where a parameter was
    not estimated.
    """
    result = np.full(len(parameters), np.nan)
    finite = np.isfinite(std) & (std > 0)
    result[finite] = (parameters[finite] / std[finite]) ** 2
    return result


def prune(
    solution: LeastSquares,
    inflation: FloatArray,
    effective_rows: float,
    refit: Callable[[tuple[int, ...]], LeastSquares],
    rule: EssentialRule = EssentialOptions.essential,
    threshold: float = SIGNIFICANT_RSD,
) -> Pruned:
    """Drop the parameter with the largest relative standard deviation, refit, and so on.

    The largest relative standard deviation is also the smallest partial F, 1e4 / RSD². Both rules therefore remove the
    same parameters in the same order and differ only in where they stop.

    Args:
        solution: of the full model.
        inflation: (b,) corrected over classical standard deviation of the full model, kept for its submodels.
        effective_rows: independent rows, for the test's degrees of freedom.
        refit: solves for a subset of the base columns.
        rule: where to stop. "rsd" removes until all are below `threshold`; "f-test" until the next removal would lose
            fit at `F_LEVEL`, whatever the threshold is.
        threshold: [%].
    """
    dropped: list[int] = []
    while len(solution.active) > 1:
        active = list(solution.active)
        freedom = max(1.0, effective_rows - len(active))
        limit = threshold if rule == "rsd" else _f_limit(freedom)
        rsd = relative_std(solution.parameters, solution.std * inflation)
        worst = active[int(np.argmax(rsd[active]))]
        if rsd[worst] < limit:
            reason = f"all below {threshold:g} %"
            if rule == "f-test":
                reason = f"partial F-test: removing one more would lose fit (RSD below {limit:.1f} %)"
            return Pruned(solution, tuple(dropped), reason)
        dropped.append(worst)
        solution = refit(tuple(column for column in active if column != worst))
    return Pruned(solution, tuple(dropped), "one parameter left")


def _f_limit(freedom: float) -> float:
    """Relative standard deviation [%] at which the partial F-test of one parameter is just significant."""
    from scipy.special import fdtri

    return 100.0 / math.sqrt(float(fdtri(1, freedom, 1.0 - F_LEVEL)))
