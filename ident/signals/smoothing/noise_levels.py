"""Noise levels of a signal's Kalman model: stated, or by maximum likelihood of its innovations."""

from __future__ import annotations

import math

import numpy as np

from drivers.core.arrays import FloatArray
from ident.signals.smoothing.kalman import innovations, stationary_filter

HIGHEST_CUTOFF = 0.2
"""Share of the rate below which the smoother's cut-off is sought; above, next to nothing is smoothed."""

MOST_SAMPLES = 20_000
"""From the middle of a longer record; more say the same."""

_CUTOFFS_TRIED = 12  # cut-offs that are tried before the best of them is refined
_CUTOFF_ACCURACY = 0.01  # relative accuracy of the cut-off
_FILTER_ROUNDING = (
    1e-12  # of the largest sample: what remains of a signal without any noise, by any processor's arithmetic
)


def cutoff_of_noise(density: float, variance: float, rate: float, order: int) -> float:
    """Cut-off f_c [Hz] of the smoother for noise levels: (2π·f_c)^(2m) = q·rate / r.

    Args:
        density: q, of the m-th derivative [unit of the samples² / s^(2m − 1)].
        variance: r, of a sample [unit of the samples²].
        rate: [Hz].
        order: m of the model.
    """
    return float((density * rate / variance) ** (0.5 / order) / (2.0 * math.pi))


def likeliest_cutoff(samples: FloatArray, rate: float, order: int, lowest_cutoff: float) -> float:
    """Cut-off [Hz] of the smoother, from the ratio of both noises, that makes the innovations likeliest.

    With the variance of the samples eliminated, the likelihood is largest where the mean square of the innovations of
    the stationary filter is smallest, so the cut-off is the only unknown.

    Args:
        samples: (N,) on a uniform grid.
        rate: [Hz].
        order: m of the model.
        lowest_cutoff: [Hz] below it the smoother would distort the motion.
    """
    from scipy.optimize import minimize_scalar

    middle = _middle(samples)
    highest = HIGHEST_CUTOFF * rate
    lowest = min(lowest_cutoff, highest)

    def cost(log_cutoff: float) -> float:
        square = _mean_square(middle, math.exp(log_cutoff) / rate, order)
        return math.log(square) if square > 0 else -math.inf

    grid = np.linspace(math.log(lowest), math.log(highest), _CUTOFFS_TRIED)
    costs = [cost(value) for value in grid]
    best = int(np.argmin(costs))
    chosen = float(grid[best])
    if math.isfinite(costs[best]) and lowest < highest:
        bounds = (grid[max(0, best - 1)], grid[min(_CUTOFFS_TRIED - 1, best + 1)])
        refined = minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": _CUTOFF_ACCURACY})
        if refined.fun < costs[best]:
            chosen = float(refined.x)
    return math.exp(chosen)


def sample_noise(samples: FloatArray, rate: float, order: int, cutoff: float) -> float:
    """Standard deviation √r of a sample's noise, with what the model does not follow of the motion.

    Arguments as those of `likeliest_cutoff`, with the smoother's `cutoff` [Hz].
    """
    innovation = stationary_filter(2.0 * math.pi * cutoff / rate, order).innovation
    return math.sqrt(_mean_square(_middle(samples), cutoff / rate, order) / innovation)


def _middle(samples: FloatArray) -> FloatArray:
    first = max(0, (len(samples) - MOST_SAMPLES) // 2)
    return samples[first : first + MOST_SAMPLES]


def _mean_square(samples: FloatArray, relative_cutoff: float, order: int) -> float:
    """Mean square of the innovations, without those while the filter settles; `relative_cutoff` = f_c·T."""
    errors = innovations(samples, 2.0 * math.pi * relative_cutoff, order)
    settling = min(math.ceil(2.0 / relative_cutoff), len(errors) // 2)
    square = float(np.mean(errors[settling:] ** 2))
    return square if square > (_FILTER_ROUNDING * np.abs(samples).max()) ** 2 else 0.0
