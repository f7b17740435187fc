"""Repairs of recorded samples, by the names that `dynid import --repair` takes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from drivers.core.arrays import FloatArray

DROP_NAN = "drop-nan"
DROP_DUPLICATES = "drop-duplicates"
DROP_REPEATS = "drop-repeats"
OPPOSITE_TORQUE = "opposite-torque"
SORT = "sort"
UNWRAP = "unwrap"
REPAIRS: Mapping[str, str] = {
    DROP_NAN: "leave out samples with NaN or infinite values, and quantities that have no finite value at all",
    DROP_DUPLICATES: "of samples with the same time stamp keep the first",
    DROP_REPEATS: "leave out samples that repeat the one before while the arm moves",
    OPPOSITE_TORQUE: "change the sign of all torques, currents and voltages",
    SORT: "sort samples that arrived out of order by their time stamp",
    UNWRAP: "let stamps of a counter of 16, 31 or 32 bits that began anew go on",
}
"""Repairs by name, with what each one does; none is made without a request."""

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
    likely = (one for one in ranges if one >= LEAST_PERIODS * period)
    return next((one for one in likely if 0.0 < one - back <= NEAR_PERIODS * period), None)


def unwrapped(time: FloatArray) -> FloatArray:
    """The stamps (N,) [s] with the counter's range added wherever it began anew."""
    added = np.zeros_like(time)
    for sample in (np.flatnonzero(np.diff(time) < 0) + 1).tolist():
        added[sample:] += counter_range(time, sample) or 0.0
    return time + added
