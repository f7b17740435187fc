"""How evenly a stream was sampled: rate, jitter, lost samples, duplicates, gaps.

Stamps of arrival come in bursts where the computer was busy: a pause, then all that waited at once. The median interval
is then that within the bursts, and a pause says nothing of a loss. Where intervals scatter so, the rate is that over
a quarter of a second. In any stream a gap counts as lost samples only as far as those around it do not make up for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from daq.recording.quality.windows import least_within
from drivers.core.arrays import FloatArray

LOST_FROM = 1.5
"""An interval longer than this many periods means that samples are missing."""

SCATTERED = 0.25
"""Median deviation of the intervals, over their median, from which the median is no measure of the period."""

BETWEEN_MULTIPLES = 0.15
"""Median distance of the longer intervals from multiples of the median one that shows the same."""

MOST_MISSING = 2.0
"""Mean interval over the median one that shows the same: of losses, half of all samples and more within `AVERAGED`."""

AVERAGED = 0.25
"""Time [s] over which bursts average out: a busy computer pauses for less."""

LEAST_AVERAGED = 10
"""Samples at least over which they do."""

LONGEST_INTERVAL = 1e9
"""Intervals [s] are cut to this: a stamp 30 years later is invalid, whatever its value."""


@dataclass(frozen=True)
class Gap:
    """A gap: a time without samples."""

    start: float  # last stamp before it [s]
    duration: float  # to the next stamp [s]
    lost: int  # samples that are missing, at the stream's period


@dataclass(frozen=True)
class StreamQuality:
    """Figures of one stream's own clock."""

    samples: int  # number of samples
    duration: float  # first to last stamp [s]
    # one over the median interval, or over the mean one of a quarter of a second where intervals scatter as those of
    # arrivals do; nan below two samples
    rate_hz: float
    jitter_ms: float  # root mean square deviation of the intervals without gaps from the median [ms]
    longest_ms: float  # longest interval [ms]
    lost: int  # samples missing in all gaps, those left out for which the samples around it make up
    duplicates: int  # intervals that are zero or negative
    gaps: tuple[Gap, ...]  # where samples are missing


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
    period = _period(forward)
    periods = np.minimum(np.round(intervals / max(period, 1.0 / LONGEST_INTERVAL)), LONGEST_INTERVAL)
    missing = np.maximum(periods.astype(int) - 1, 0) * (intervals > LOST_FROM * period)
    missing[intervals > 0] = np.minimum(missing[intervals > 0], _not_made_up(forward, period))
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


def _period(intervals: FloatArray) -> float:
    """The period [s] of a stream from its intervals (k,) above 0."""
    period, averaged = float(np.median(intervals)), _averaged_period(intervals)
    scattered = float(np.median(np.abs(intervals - period))) > SCATTERED * period
    if not scattered and averaged > LOST_FROM * period:
        # Losses leave multiples of the period; pauses between bursts have any length.
        multiples = intervals[intervals > LOST_FROM * period] / period
        between = float(np.median(np.abs(multiples - np.round(multiples)))) > BETWEEN_MULTIPLES
        scattered = between or averaged > MOST_MISSING * period
    return averaged if scattered else period


def _averaged_period(intervals: FloatArray) -> float:
    """Median of the means of consecutive intervals (k,), so many that bursts average out [s]."""
    span = _averaged(float(np.mean(intervals)), len(intervals))
    stamps = np.concatenate([[0.0], np.cumsum(intervals)])
    return float(np.median(stamps[span:] - stamps[:-span])) / span


def _not_made_up(intervals: FloatArray, period: float) -> npt.NDArray[np.int64]:
    """Samples (k,) by which the stream is later after each interval than before it, by those that came in time."""
    # Intervals that are skewed have a mean below their median, and would seem to make up for every loss.
    least = max(min(period, _averaged_period(intervals)), 1.0 / LONGEST_INTERVAL)
    late = np.concatenate([[0.0], np.cumsum(intervals / least - 1.0)])
    after, before = _averaged(period, len(intervals)), min(LEAST_AVERAGED, len(intervals))
    padded = np.pad(late, after, constant_values=np.inf)
    place = after + np.arange(len(intervals))
    came = least_within(padded, 0, 2 * (after // 2))[place + 1]
    lacking = came - least_within(padded, 2 * (before // 2), 0)[place]
    return np.asarray(np.maximum(np.round(np.minimum(lacking, LONGEST_INTERVAL)), 0.0).astype(np.int64))


def _averaged(period: float, intervals: int) -> int:
    """Number of intervals, of so many, over which bursts average out."""
    wanted = min(AVERAGED / max(period, 1.0 / LONGEST_INTERVAL), float(intervals))
    return min(max(LEAST_AVERAGED, int(wanted)), intervals)
