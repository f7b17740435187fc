"""How evenly a stream was sampled: rate, jitter, lost samples, duplicates, gaps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.streams import FloatArray

LOST_FROM = 1.5
"""An interval longer than this many periods means that samples are missing."""

LONGEST_INTERVAL = 1e9
"""Intervals [s] are cut to this: a stamp 30 years later is invalid, whatever its value."""


@dataclass(frozen=True)
class Gap:
    """A gap: a time without samples.

    Attributes:
        start: last stamp before it [s].
        duration: to the next stamp [s].
        lost: samples that are missing, at the stream's period.
    """

    start: float
    duration: float
    lost: int


@dataclass(frozen=True)
class StreamQuality:
    """Figures of one stream's own clock.

    Attributes:
        samples: number of samples.
        duration: first to last stamp [s].
        rate_hz: one over the median interval; nan below two samples.
        jitter_ms: root mean square deviation of the intervals without gaps from the median [ms].
        longest_ms: longest interval [ms].
        lost: samples missing in all gaps.
        duplicates: intervals that are zero or negative.
        gaps: where samples are missing.
    """

    samples: int
    duration: float
    rate_hz: float
    jitter_ms: float
    longest_ms: float
    lost: int
    duplicates: int
    gaps: tuple[Gap, ...]


def stream_quality(time: FloatArray) -> StreamQuality:
    """Figures for the stamps (N,) [s] of a stream."""
    nan = float("nan")
    samples, time = len(time), time[np.isfinite(time)]
    if len(time) < 2:
        return StreamQuality(samples, 0.0, nan, nan, nan, 0, 0, ())
    with np.errstate(over="ignore"):  # stamps that are nonsense must not end in a warning
        intervals = np.clip(np.diff(time), -LONGEST_INTERVAL, LONGEST_INTERVAL)
    forward = intervals[intervals > 0]
    duplicates = len(intervals) - len(forward)
    if len(forward) == 0:
        return StreamQuality(samples, 0.0, nan, nan, nan, 0, duplicates, ())
    period = float(np.median(forward))
    periods = np.minimum(np.round(intervals / max(period, 1.0 / LONGEST_INTERVAL)), LONGEST_INTERVAL)
    missing = np.maximum(periods.astype(int) - 1, 0) * (intervals > LOST_FROM * period)
    regular = forward[forward <= LOST_FROM * period]
    return StreamQuality(
        samples=samples,
        duration=float(time[-1] - time[0]),
        rate_hz=1.0 / period,
        jitter_ms=1e3 * float(np.sqrt(np.mean((regular - period) ** 2))),
        longest_ms=1e3 * float(np.max(intervals)),
        lost=int(missing.sum()),
        duplicates=duplicates,
        gaps=tuple(Gap(float(time[i]), float(intervals[i]), int(missing[i])) for i in np.flatnonzero(missing)),
    )
