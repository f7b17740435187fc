"""Savitzky-Golay: a polynomial of degree four through a sliding window, which gives the signal and its derivatives."""

from __future__ import annotations

import math

import numpy as np

from drivers.core.arrays import FloatArray

DEGREE = 4
"""Degree of the polynomial: the second derivative is exact for signals up to the fifth degree."""


def savitzky_golay_gain(relative_frequency: float, half_width: int) -> float:
    """Gain of the smoothed signal at a frequency given in parts of the sampling rate; zero phase."""
    from scipy.signal import savgol_coeffs

    weights = savgol_coeffs(2 * half_width + 1, DEGREE)
    offsets = np.arange(-half_width, half_width + 1)
    return float(weights @ np.cos(2.0 * math.pi * relative_frequency * offsets))


def half_width_for(cutoff: float, rate: float, samples: int) -> int:
    """Samples on either side in the longest window whose gain at `cutoff` [Hz] is at least one half.

    Args:
        cutoff: [Hz].
        rate: [Hz].
        samples: of the shortest signal, which bounds the window.
    """
    narrow, wide = DEGREE // 2 + 1, max(DEGREE // 2 + 1, (samples - 1) // 2)
    # The gain decreases until the window spans 2.4 periods, where it vanishes.
    wide = min(wide, max(narrow, math.ceil(1.2 * rate / cutoff)))
    while narrow < wide:
        middle = (narrow + wide + 1) // 2
        if savitzky_golay_gain(cutoff / rate, middle) >= 0.5:
            narrow = middle
        else:
            wide = middle - 1
    return narrow


def savitzky_golay(rows: FloatArray, rate: float, half_width: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The smoothed `rows` (n, N) at `rate` [Hz], their first and their second derivative, each (n, N)."""
    from scipy.signal import savgol_filter

    window = 2 * half_width + 1
    smooth, first, second = (
        np.asarray(savgol_filter(rows, window, DEGREE, deriv=derivative, delta=1.0 / rate, axis=1))
        for derivative in range(3)
    )
    return smooth, first, second
