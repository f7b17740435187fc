"""Noise levels of a signal's Kalman model, by maximum likelihood of its innovations."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from drivers.streams import FloatArray
from ident.signals.smoothing.kalman import innovations, stationary_filter

HIGHEST_CUTOFF = 0.2
"""Of the rate: the smoother's cut-off is sought below it; above, next to nothing is smoothed."""

MOST_SAMPLES = 20_000
"""From the middle of a longer record; more say the same."""

_GRID = 12  # cut-offs that are tried before the best of them is refined
_REFINED = 0.01  # relative accuracy of the cut-off
_ROUNDING = 1e-14  # of the largest sample: what remains of a signal without any noise


@dataclass(frozen=True)
class NoiseLevels:
    """What the innovations say of a signal.

    Attributes:
        cutoff: of the smoother [Hz]: from the ratio of both noises.
        sample_std: standard deviation √r of a sample's noise, and of what the model does not follow of the motion
            [unit of the samples].
    """

    cutoff: float
    sample_std: float


def noise_levels(samples: FloatArray, rate: float, order: int, lowest_cutoff: float) -> NoiseLevels:
    """Noise of the samples and cut-off of the smoother that make the innovations likeliest.

    With the variance of the samples eliminated, the likelihood is largest where the mean square of the innovations of
    the stationary filter is smallest, so the cut-off is the only unknown.

    Args:
        samples: (N,) on a uniform grid.
        rate: [Hz].
        order: m of the model.
        lowest_cutoff: [Hz] below it the smoother would distort the motion.
    """
    from scipy.optimize import minimize_scalar

    first = max(0, (len(samples) - MOST_SAMPLES) // 2)
    middle = samples[first : first + MOST_SAMPLES]
    highest = HIGHEST_CUTOFF * rate
    lowest = min(lowest_cutoff, highest)

    def cost(log_cutoff: float) -> float:
        square = _mean_square(middle, math.exp(log_cutoff) / rate, order)
        return math.log(square) if square > 0 else -math.inf

    grid = np.linspace(math.log(lowest), math.log(highest), _GRID)
    costs = [cost(value) for value in grid]
    best = int(np.argmin(costs))
    chosen = float(grid[best])
    if math.isfinite(costs[best]) and lowest < highest:
        bounds = (grid[max(0, best - 1)], grid[min(_GRID - 1, best + 1)])
        refined = minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": _REFINED})
        if refined.fun < costs[best]:
            chosen = float(refined.x)
    cutoff = math.exp(chosen)
    step = 2.0 * math.pi * cutoff / rate
    variance = _mean_square(middle, cutoff / rate, order) / stationary_filter(step, order).innovation
    return NoiseLevels(cutoff, math.sqrt(variance))


def _mean_square(samples: FloatArray, relative_cutoff: float, order: int) -> float:
    """Mean square of the innovations, without those while the filter settles; `relative_cutoff` = f_c·T."""
    errors = innovations(samples, 2.0 * math.pi * relative_cutoff, order)
    settling = min(math.ceil(2.0 / relative_cutoff), len(errors) // 2)
    square = float(np.mean(errors[settling:] ** 2))
    return square if square > (_ROUNDING * np.abs(samples).max()) ** 2 else 0.0
