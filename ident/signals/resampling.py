"""Bring recorded stamps to a uniform grid: how irregular they are, gaps, interpolation, a delay between two signals."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError
from drivers.core.ranges import SAMPLING_RATE, STAMP

GAP_PERIODS = 10.0
GAP_SECONDS = 0.05
"""A hole longer than both, `GAP_PERIODS` periods and `GAP_SECONDS`, is a gap: nothing is interpolated across it."""

REGULAR_WITHIN = 0.01
"""Stamps count as regular when none is further than this fraction of a period from a uniform grid."""

PERIOD_ROWS, LONGEST_SPREAD, IN_TIME = 500, 50, 0.25
"""Rows over which the period is measured, rows over which repeated stamps are spread at most, and the deviation from
the period [periods] of a stamp that is in time."""


@dataclass(frozen=True)
class Irregularity:
    """How far recorded stamps are from a uniform grid."""

    median_period: float  # between two stamps [s]
    shortest: float  # period [s]
    longest: float  # period [s], gaps included
    rms_deviation: float  # of the periods from the median, gaps left out [s]
    gaps: int  # number of holes that were not interpolated
    duplicates: int  # samples left out because they repeat their predecessor's stamp
    regular: bool  # whether the samples were used unchanged, without interpolation

    @property
    def rate(self) -> float:
        """Rate of the uniform grid [Hz], from the median period."""
        return float(f"{1 / self.median_period:.6g}")


def check_stamps(time: FloatArray) -> None:
    """Refuse stamps that go backwards or are not numbers; equal neighbours pass.

    Raises:
        DataError: naming the first bad sample.
    """
    bad = np.flatnonzero(~np.isfinite(time))
    if len(bad):
        raise DataError("the time stamp is not a number", where=f"sample {bad[0]}", hint="leave the sample out")
    bad = np.flatnonzero(np.abs(time) > STAMP.most)
    if len(bad):
        raise DataError(f"the time stamp {time[bad[0]]:g} s is not within {STAMP}", where=f"sample {bad[0]}")
    backwards = np.flatnonzero(np.diff(time) < 0)
    if len(backwards):
        first = int(backwards[0])
        raise DataError(
            f"time goes backwards, from {time[first]:.6f} s to {time[first + 1]:.6f} s",
            where=f"sample {first + 1}",
            hint="sort the samples by their stamps, or split the recording there",
        )


def check_rate(rate: float, where: str = "") -> None:
    """Refuse a rate of an arm's samples [Hz] that comes of stamps in another unit; NaN, which is none, passes.

    Raises:
        DataError: it is not within `SAMPLING_RATE`.
    """
    if np.isfinite(rate) and not SAMPLING_RATE.holds(rate):
        raise DataError(
            f"{rate:.4g} samples per second is not a plausible rate for a robot arm ({SAMPLING_RATE})",
            where=where,
            hint="the time stamps are probably not in seconds",
        )


def spread_stamps(time: FloatArray) -> FloatArray:
    """Stamps (N,) [s] of which repeated ones are spread evenly up to the next one that is in time.

    A clock that is coarser than the samples, or is read late, repeats a stamp and makes up for it: then the samples
    were even. A sample that was recorded twice is not made up for; its stamp stays repeated.
    """
    span = min(PERIOD_ROWS, len(time) - 1)
    period = float(np.median(time[span:] - time[:-span])) / span if span else 0.0
    spread, first = time.copy(), 0
    for repeated in np.flatnonzero(np.diff(time) == 0.0).tolist():
        if repeated < first:
            continue
        rows = np.arange(2, min(LONGEST_SPREAD, len(time) - 1 - repeated) + 1)
        in_time = np.abs(time[repeated + rows] - time[repeated] - rows * period) <= IN_TIME * period
        if in_time.any():
            first = repeated + int(rows[np.argmax(in_time)])
            spread[repeated : first + 1] = np.linspace(time[repeated], time[first], first - repeated + 1)
    return spread


def measure_irregularity(time: FloatArray) -> Irregularity:
    """Return how irregular the stamps `time` (N,) [s] are; N ≥ 2, checked by `check_stamps`.

    Raises:
        DataError: fewer than two different stamps.
    """
    periods = np.diff(time)
    duplicates = int((periods == 0).sum())
    periods = periods[periods > 0]
    if len(periods) == 0:
        raise DataError("fewer than two samples with different time stamps")
    median = float(np.median(periods))
    check_rate(1.0 / max(median, np.finfo(float).tiny))
    gap = periods > max(GAP_PERIODS * median, GAP_SECONDS)
    # Against the mean period of the whole: a clock that runs a little fast or slow is no irregularity.
    distinct = np.concatenate([[0.0], np.cumsum(periods)])
    ideal = np.linspace(0.0, distinct[-1], len(distinct))
    off_grid = float(np.abs(distinct - ideal).max())
    return Irregularity(
        median_period=median,
        shortest=float(periods.min()),
        longest=float(periods.max()),
        rms_deviation=float(np.sqrt(np.mean((periods[~gap] - median) ** 2))),
        gaps=int(gap.sum()),
        duplicates=duplicates,
        regular=off_grid <= REGULAR_WITHIN * median,
    )


def gap_free_segments(time: FloatArray, median_period: float) -> tuple[slice, ...]:
    """The gap-free segments of `time` (N,), as slices."""
    gaps = np.flatnonzero(np.diff(time) > max(GAP_PERIODS * median_period, GAP_SECONDS)) + 1
    edges = [0, *gaps.tolist(), len(time)]
    return tuple(slice(start, stop) for start, stop in pairwise(edges))


def uniform_grid(start: float, stop: float, rate: float) -> FloatArray:
    """Instants (K,) [s] from `start` at `rate` [Hz], none behind `stop` (but for rounding)."""
    count = int(np.floor((stop - start) * rate + 1e-6)) + 1
    return np.asarray(start + np.arange(count) / rate)


def resample(time: FloatArray, rows: FloatArray, grid: FloatArray) -> FloatArray:
    """Cubic spline (not-a-knot) through `rows` (n, N) at the stamps `time` (N,), evaluated at `grid` (K,) → (n, K).

    All signals get the same spline: its gain differs from 1 by less than (f/f_s)⁴·10 and is the same for τ and q,
    where a straight line between samples would lower τ by up to (πf/f_s)²/2 and not change q. Fewer than four samples
    are joined by straight lines.
    """
    if len(time) < 4:
        return np.stack([np.interp(grid, time, row) for row in rows])
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(time, rows, axis=1)
    return np.ascontiguousarray(spline(np.minimum(grid, time[-1])))


def shift_torque(torque: FloatArray, rate: float, delay: float) -> FloatArray:
    """The torque `delay` [s] later: `torque` (n, N) at `rate` [Hz] → (n, N), column k at time t_k + delay.

    Cubic through the four neighbours (Lagrange). Positive where the torque lags behind the position. Before the first
    and after the last sample the end's value is held: those columns are not measurements, see `shiftable`.
    """
    whole, fraction = _whole_and_fraction(delay * rate)
    last = torque.shape[1] - 1
    columns = np.arange(last + 1) + whole
    if fraction == 0:
        return np.ascontiguousarray(torque[:, np.clip(columns, 0, last)])
    weights = (
        -fraction * (fraction - 1) * (fraction - 2) / 6,
        (fraction + 1) * (fraction - 1) * (fraction - 2) / 2,
        -(fraction + 1) * fraction * (fraction - 2) / 2,
        (fraction + 1) * fraction * (fraction - 1) / 6,
    )
    shifted = np.zeros_like(torque)
    for offset, weight in zip((-1, 0, 1, 2), weights, strict=True):
        shifted += weight * torque[:, np.clip(columns + offset, 0, last)]
    return shifted


def shiftable(samples: int, rate: float, delay: float) -> slice:
    """The columns of `shift_torque` of N = `samples` that depend on measured samples only; may be empty."""
    whole, fraction = _whole_and_fraction(delay * rate)
    before, behind = (1, 2) if fraction else (0, 0)
    start = min(max(0, before - whole), samples)
    return slice(start, max(start, min(samples, samples - behind - whole)))


def _whole_and_fraction(periods: float) -> tuple[int, float]:
    """Whole periods and the remainder in [0, 1); a remainder within rounding is none."""
    whole = int(np.floor(periods + 1e-9))
    fraction = periods - whole
    return whole, fraction if fraction > 1e-9 else 0.0
