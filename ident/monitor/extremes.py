"""Extreme values: the level that the largest of many correlated values passes at a rate that somebody names.

Maxima of blocks that are longer than the correlation are declustered peaks; those above a high quantile follow a
generalised Pareto distribution (Coles, "An introduction to statistical modeling of extreme values", 2001, ch. 4), here
fitted by probability-weighted moments (Hosking and Wallis, Technometrics 29, 1987).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError
from drivers.core.text import counted

PEAK_SHARE = 0.25
"""Share of the blocks whose maxima are taken for peaks."""
FEWEST_PEAKS = 20
"""Fewer say nothing of a tail."""
FARTHEST = 2000.0
"""Largest ratio of the time between two passes that is asked for to the time observed."""
DRAWS = 200
"""Fits of data drawn from the fitted tail, for the interval of a level."""
CONFIDENCE = 0.90
SHAPE_STD = 0.1
"""σ of the shapes that are expected before any data: measured torques have tails near an exponential one."""


@dataclass(frozen=True)
class ReturnLevel:
    """A level and how well it is known."""

    level: float  # that is passed at the rate asked for, on average over what the data leave open of the tail
    interval: tuple[float, float]  # of the level of the true tail, 90 %
    hours: float  # observed [h]
    extrapolation: float  # time between two passes over the time observed
    peaks: int  # that the tail was fitted to
    shape: float  # ξ of the tail; 0 is exponential, more is heavier


def require_time(seconds: float, block: float, per_hour: float) -> None:
    """Refuse an observed time [s], in blocks [s], that is too short for a rate of passes per hour.

    Raises:
        DataError: says how much is needed.
    """
    needed = max(FEWEST_PEAKS / PEAK_SHARE * block, 3600.0 / (per_hour * FARTHEST))
    if seconds < needed:
        raise DataError(
            f"{seconds:.3g} s without contact is too short for {counted(per_hour, 'false alarm')} per hour: at least "
            f"{needed:.3g} s of motion are needed",
            hint="give a longer recording without contact, or allow more false alarms per hour",
        )


def return_level(maxima: FloatArray, hours: float, per_hour: float) -> ReturnLevel:
    """The level that maxima of blocks pass so many times per hour.

    Args:
        maxima: (B,) of blocks, at least `FEWEST_PEAKS` / `PEAK_SHARE` of them.
        hours: that were observed, blocks without a value included [h].
        per_hour: passes per hour.
    """
    count = round(PEAK_SHARE * len(maxima))
    ordered = np.sort(maxima)
    start = float(ordered[-count - 1])
    shape, scale = _fitted(ordered[-count:] - start)
    ratio = max(count / hours / per_hour, 1.0)
    generator = np.random.default_rng(0)  # the same data have the same interval
    tails = [_fitted(_drawn(generator, shape, scale, count)) for _ in range(DRAWS)]
    levels = [_passed(*tail, ratio) for tail in tails]
    shapes, scales = np.array(tails).T

    def passes(excess: float) -> float:
        """Peaks that pass an excess, on average over the tails, less those asked for."""
        heavy = np.maximum(shapes, 1e-9)
        return float(np.mean((1.0 + heavy * excess / scales) ** (-1.0 / heavy))) - 1.0 / ratio

    highest = max(levels)
    level = float(brentq(passes, 0.0, highest)) if passes(highest) < 0.0 < passes(0.0) else highest
    low, high = np.quantile(levels, [0.5 - CONFIDENCE / 2.0, 0.5 + CONFIDENCE / 2.0]).tolist()
    interval = (start + min(low, level), start + max(high, level))
    return ReturnLevel(start + level, interval, hours, 1.0 / (per_hour * hours), count, shape)


def _fitted(excess: FloatArray) -> tuple[float, float]:
    """Shape and scale of a generalised Pareto distribution.

    The shape is drawn towards 0, an exponential tail, as few peaks say little of it; one below 0 would end the tail.
    """
    ordered = np.sort(excess)
    count = len(ordered)
    mean = float(ordered.mean())
    weighted = float(np.sum(ordered * (count - 1.0 - np.arange(count))) / (count * (count - 1.0)))
    shape = 2.0 - mean / max(mean - 2.0 * weighted, 1e-12)
    shape *= SHAPE_STD**2 / (SHAPE_STD**2 + 1.0 / count)
    shape = min(max(shape, 0.0), 0.5)
    return shape, max(mean * (1.0 - shape), 1e-12)


def _passed(shape: float, scale: float, ratio: float) -> float:
    """Excess that one in `ratio` peaks passes."""
    return float(scale * (np.log(ratio) if shape < 1e-6 else (ratio**shape - 1.0) / shape))


def _drawn(generator: np.random.Generator, shape: float, scale: float, count: int) -> FloatArray:
    uniform = generator.uniform(size=count)
    return np.asarray(-scale * np.log(uniform) if shape < 1e-6 else scale * (uniform**-shape - 1.0) / shape)
