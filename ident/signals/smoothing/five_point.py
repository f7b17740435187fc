"""Five-point cubic smoothing, pass after pass (the "five-point thrice smoothing" of ROCR6 section 4.2)."""

from __future__ import annotations

import math

import numpy as np

from drivers.core.arrays import FloatArray

MOST_PASSES = 200
"""A low cut-off at a high rate would need thousands: the gain falls with the fourth power of the frequency."""

_WEIGHTS = (17.0 / 35.0, 12.0 / 35.0, -3.0 / 35.0)  # of a sample, its neighbours, and theirs
_FIRST = np.array([69.0, 4.0, -6.0, 4.0, -1.0]) / 70.0
_SECOND = np.array([2.0, 27.0, 12.0, -8.0, 2.0]) / 35.0


def five_point_gain(relative_frequency: float, passes: int) -> float:
    """Gain of `passes` passes at a frequency given in parts of the sampling rate."""
    angle = 2.0 * math.pi * relative_frequency
    once = _WEIGHTS[0] + 2.0 * _WEIGHTS[1] * math.cos(angle) + 2.0 * _WEIGHTS[2] * math.cos(2.0 * angle)
    return once**passes


def passes_for(cutoff: float, rate: float) -> int:
    """The passes whose gain at `cutoff` [Hz] is nearest to one half, at most `MOST_PASSES`; `rate` [Hz]."""
    once = five_point_gain(cutoff / rate, 1)
    if once <= 0.5:
        return 1
    return min(MOST_PASSES, max(1, round(math.log(0.5) / math.log(once)))) if once < 1.0 else MOST_PASSES


def half_gain_frequency(passes: int, rate: float) -> float:
    """Frequency [Hz] at which the gain of `passes` passes is one half."""
    from scipy.optimize import brentq

    return rate * float(brentq(lambda relative: five_point_gain(relative, passes) - 0.5, 0.0, 0.36))


def five_point_cubic(rows: FloatArray, passes: int) -> FloatArray:
    """Each sample replaced by the cubic through it and two neighbours on either side, `passes` times.

    Args:
        rows: (n, N), N ≥ 5; the first and the last two samples of a row take the cubic of the row's first or last five.
        passes: how many times.
    """
    smooth = np.array(rows, dtype=np.float64)
    for _ in range(passes):
        inner = _WEIGHTS[0] * smooth[:, 2:-2]
        inner += _WEIGHTS[1] * (smooth[:, 1:-3] + smooth[:, 3:-1])
        inner += _WEIGHTS[2] * (smooth[:, :-4] + smooth[:, 4:])
        start, end = smooth[:, :5].copy(), smooth[:, :-6:-1].copy()
        smooth[:, 2:-2] = inner
        smooth[:, 0], smooth[:, 1] = start @ _FIRST, start @ _SECOND
        smooth[:, -1], smooth[:, -2] = end @ _FIRST, end @ _SECOND
    return smooth
