"""Time stamps of a counter that began anew at its end."""

from __future__ import annotations

import numpy as np

from drivers.core.arrays import FloatArray

COUNTER_BITS = (16, 31, 32)
COUNTER_UNITS = (1.0, 1e-3, 1e-4, 1e-6, 1e-7, 1e-9)
"""Bits of a counter of time, and its unit [s]."""

LEAST_PERIODS = 50.0
"""Periods that a counter's range holds at least; shuffled samples go back by less."""

NEAR_PERIODS = 3.0
"""Periods within which a stamp that follows the counter's end comes."""


def counter_range(time: FloatArray, sample: int) -> float | None:
    """Range [s] of the counter whose end explains that a stamp is before the one before; None where none does."""
    steps = np.diff(time)
    period = float(np.median(steps[steps > 0])) if np.any(steps > 0) else np.inf
    back = float(time[sample - 1] - time[sample])
    ranges = (2.0**bits * unit for bits in COUNTER_BITS for unit in COUNTER_UNITS)
    likely = (entry for entry in ranges if entry >= LEAST_PERIODS * period)
    return next((counter for counter in likely if 0.0 < counter - back <= NEAR_PERIODS * period), None)


def unwrapped(time: FloatArray) -> FloatArray:
    """The stamps (N,) [s] with the counter's range added wherever it began anew."""
    added = np.zeros_like(time)
    for sample in (np.flatnonzero(np.diff(time) < 0) + 1).tolist():
        added[sample:] += counter_range(time, sample) or 0.0
    return time + added
