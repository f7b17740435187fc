"""Properties of a recorded signal, column by column: steps, noise, clipping, outliers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from daq.recording.quality.outliers import without_outliers
from daq.recording.quality.quantisation import quantisation_step, resolution
from daq.recording.recording import Channel
from drivers.core.arrays import FloatArray, true_runs

FEWEST_FILLED = 10
"""Fewer runs of zeros between large values are switching on and off."""

FILLED_FAR = 0.3
"""Distance from 0 of both values around a filled run, over the root mean square of all that are not 0 …"""

FILLED_CHANGE = 10.0
"""… and over the median change between two of these that follow each other."""

FILLED_STEPS = 2.5
"""Steps of a coarse signal: so near 0 a value is by noise and rounding."""

CLIPPED_RUN = 5
"""At least this many equal extreme values in a row count as clipping …"""

CLIPPED_TO_NEXT = 4.0
"""… if this many times as many as on the level beside them: a rounded peak has 2.4 times as many at most."""

FEWEST_LEVELS = 4
"""A signal of fewer levels shows no peak."""

OTHER_SIGN = 1e-3
"""Share of a signal's samples that single wrong ones may have on the other side of zero."""

NEAR_ZERO = 0.1
"""A signal near zero, over its root mean square …"""

OFTEN = 2e-3
"""… and the share of the samples that are so near, of a signal that reaches zero as a habit."""

REVERSALS = 4
"""So often a joint must reverse for the sign of its friction to show."""

LEAST_TRAVEL = 10.0
"""Encoder steps between two reversals that count."""


@dataclass(frozen=True)
class ColumnQuality:
    """Figures of one column, in the channel's unit."""

    name: str  # of the column (a joint)
    # smallest, largest: of its values
    smallest: float
    largest: float
    noise: float  # standard deviation of its white noise: from second differences, robust against the motion
    step: float  # of quantisation; nan where the values lie on no grid
    # samples that stay at the smallest or largest value for `CLIPPED_RUN` samples or more [%]; of a magnitude at the
    # largest only
    clipped_percent: float
    filled_percent: float = 0.0  # samples that are exactly 0 between values far from it: drop-outs that were filled [%]
    outliers: int = 0  # samples far from what their neighbours say (`daq.recording.quality.outliers`)
    outliers_stay: bool = False  # whether they are too many for exceptions, and are left in the signal


def channel_quality(channel: Channel, time: FloatArray) -> tuple[ColumnQuality, ...]:
    """Figures of every column of a channel (N, n) with stamps (N,) [s]; nan for a column without finite values."""
    clean = without_outliers(time, channel.values)
    return tuple(
        replace(
            _column_quality(name, channel.values[:, k], magnitude=channel.magnitude),
            outliers=int(clean.replaced[k] + clean.left[k]),
            outliers_stay=bool(clean.left[k]),
        )
        for k, name in enumerate(channel.columns)
    )


def _column_quality(name: str, column: FloatArray, *, magnitude: bool) -> ColumnQuality:
    values = column[np.isfinite(column)]
    if len(values) == 0:
        nan = float("nan")
        return ColumnQuality(name, nan, nan, nan, nan, nan)
    return ColumnQuality(
        name=name,
        smallest=float(values.min()),
        largest=float(values.max()),
        noise=white_noise(values),
        step=quantisation_step(values),
        clipped_percent=100.0 * float(np.mean(_clipped(values, magnitude=magnitude))),
        filled_percent=0.0 if magnitude else 100.0 * float(np.mean(_zero_filled(values))),
    )


def white_noise(values: FloatArray) -> float:
    """Standard deviation of a signal's white noise, from the median magnitude of its second differences (N,).

    Second differences of white noise have √6 times its deviation; the median of their size is 0.6745 of that.
    """
    if len(values) < 3:
        return float("nan")
    return float(np.median(np.abs(np.diff(values, n=2))) / (0.6745 * np.sqrt(6.0)))


def _clipped(values: FloatArray, *, magnitude: bool) -> npt.NDArray[np.bool_]:
    # A magnitude rests at 0; one of negative values, at its largest one.
    levels, counts = np.unique(values, return_counts=True)
    if len(levels) < FEWEST_LEVELS:
        return np.zeros(len(values), dtype=bool)
    at_ends = [
        level
        for level, often, beside in ((levels[0], counts[0], counts[1]), (levels[-1], counts[-1], counts[-2]))
        if not (magnitude and level == 0.0) and often >= CLIPPED_TO_NEXT * beside
    ]
    extreme = np.isin(values, at_ends)
    clipped = np.zeros(len(values), dtype=bool)
    for start, stop in true_runs(extreme):
        if stop - start >= CLIPPED_RUN:
            clipped[start:stop] = True
    return clipped


def _zero_filled(values: FloatArray) -> npt.NDArray[np.bool_]:
    """(N,) samples in runs of zeros between values that no signal reaches from 0 within one sample."""
    zero = values == 0.0
    filled = np.zeros(len(values), dtype=bool)
    if zero.all() or not zero.any():
        return filled
    size = float(np.sqrt(np.mean(values[~zero] ** 2)))
    changes = np.abs(np.diff(values))[~zero[1:] & ~zero[:-1]]
    step = float(np.min(np.diff(np.unique(values))))
    typical = float(np.median(changes)) if len(changes) >= FEWEST_FILLED else 0.0
    far = max(FILLED_FAR * size, FILLED_CHANGE * typical, FILLED_STEPS * step)
    edges = np.array(true_runs(zero))
    inner = edges[(edges[:, 0] > 0) & (edges[:, 1] < len(values))]
    runs = inner[np.minimum(np.abs(values[inner[:, 0] - 1]), np.abs(values[inner[:, 1]])) > far]
    if len(runs) >= FEWEST_FILLED:
        for start, stop in runs:
            filled[start:stop] = True
    return filled


def unsigned_joints(signal: FloatArray, position: FloatArray) -> tuple[int, ...]:
    """Joints whose signal stays on one side of zero and reaches it, although they reverse again and again.

    Empty where any joint's signal has both signs: one kind of drive gives one kind of signal. A signed signal may stay
    on one side while gravity outweighs friction, but then it keeps away from zero, or noise takes it across. The signal
    (N, n) is a current, voltage or torque.
    """
    finite = np.isfinite(signal).all(axis=1) & np.isfinite(position).all(axis=1)
    signal, position = signal[finite], position[finite]
    if not len(signal):
        return ()
    if np.any((np.mean(signal < 0.0, axis=0) > OTHER_SIGN) & (np.mean(signal > 0.0, axis=0) > OTHER_SIGN)):
        return ()
    size = np.sqrt(np.mean(signal**2, axis=0))
    near = np.mean(np.abs(signal) < NEAR_ZERO * size, axis=0) > OFTEN
    return tuple(
        joint for joint in np.flatnonzero(near & (size > 0.0)).tolist() if _reversals(position[:, joint]) >= REVERSALS
    )


def _reversals(position: FloatArray) -> int:
    """Return how often a position (N,) reverses by more than its noise and its encoder's steps."""
    travel = max(LEAST_TRAVEL * resolution(position), 0.05 * float(np.ptp(position)))
    levels = np.round(position / travel) if np.isfinite(travel) and travel > 0.0 else np.zeros(0)
    steps = np.diff(levels)
    directions = np.sign(steps[steps != 0.0])
    return int(np.count_nonzero(directions[1:] != directions[:-1]))
