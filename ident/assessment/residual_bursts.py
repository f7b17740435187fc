"""Short times in which the torque leaves the model by far: contacts, collisions, a cable, a hand on the arm.

A model that lacks something leaves residuals that grow and fall with the motion. A contact leaves a burst of some
tenths of a second, in several joints at once. So windows are compared with what this recording's other windows are
like: each joint's mean squared residual over its median, as a logarithm, summed over the joints, in robust standard
deviations of that sum. Windows overlap and the residuals are dependent; the median and the median deviation of the sum
do not mind. Samples near a velocity reversal do not count, where static friction is in no model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import BoolArray, FloatArray
from ident.regression.comparison import TorqueSeries

WINDOW = 0.3
"""[s] over which the squared residuals are averaged."""

FEWEST_WINDOWS = 10
"""Recordings of fewer, end to end, do not show what is usual."""

SLOW = 0.1
"""Share of its root mean square below which a joint's velocity is near a reversal."""

REVERSAL = 0.1
"""[s] before and after a reversal that do not count, since the filter spreads what happens there."""

COUNTED = 0.5
"""Share of a window's samples that must count for a joint."""

MOST_TIME = 0.25
"""Share of the time beyond which bursts are the rule, and the model is wrong."""

APART = 0.5
"""[s]; bursts that are closer are one."""

LEAST_LEVEL = 1e-6
"""Of a joint's median squared residual: what is smaller is rounding."""

_MEDIAN_OF_NORMAL = 0.6745


@dataclass(frozen=True)
class Burst:
    """A time of large residuals, by its first and last stamp [s] in its recording's clock."""

    start: float
    stop: float

    def within(self, time: FloatArray) -> BoolArray:
        """(M,) which of some stamps [s] it holds."""
        return np.asarray((time >= self.start) & (time <= self.stop))


@dataclass(frozen=True, eq=False)
class Windows:
    """All windows of a segment.

    Attributes:
        start, stop: (K,) first and last stamp [s].
        deviation: (K,) of the joints' summed log squared residual from its median, in robust σ; nan where none counts.
        larger: (K,) geometric mean over the joints of the residual over the usual one.
    """

    start: FloatArray
    stop: FloatArray
    deviation: FloatArray
    larger: FloatArray


def windows(
    series: Sequence[TorqueSeries], torques: Sequence[int], bursts: Sequence[Sequence[Burst]] | None = None
) -> list[Windows]:
    """The windows of each segment, compared with all that hold no burst; none where there are too few.

    Args:
        series: measured and predicted torques, one per segment.
        torques: indices of the motors whose torques are used.
        bursts: of each segment.
    """
    chosen = list(torques)
    squares = [np.sum(np.where(part.counted, part.velocity**2, 0.0), axis=1) for part in series]
    counts = [np.sum(part.counted, axis=1) for part in series]
    speed = np.sqrt(sum(squares) / np.maximum(1, sum(counts)))
    means = [_means(part, SLOW * speed)[chosen] for part in series]
    spans = [_spans(part) for part in series]
    kept = np.concatenate(
        [~_touched(span, [] if bursts is None else bursts[number]) for number, span in enumerate(spans)]
    )
    together = np.concatenate(means, axis=1)
    total = sum(float(span[1][-1] - span[0][0]) for span in spans if len(span[0]))
    if total < FEWEST_WINDOWS * WINDOW or not np.isfinite(together[:, kept]).any():
        return []
    usual = np.array([_median(row[kept]) for row in together])[:, None]
    shown = usual[:, 0] > 0.0
    logs = np.log(np.maximum(together[shown] / usual[shown], LEAST_LEVEL))
    known = np.isfinite(logs)
    joints = known.sum(axis=0)
    level = np.where(joints > 0, np.where(known, logs, 0.0).sum(axis=0) / np.sqrt(np.maximum(1, joints)), np.nan)
    middle = _median(level[kept])
    spread = _median(np.abs(level[kept] - middle)) / _MEDIAN_OF_NORMAL
    if not spread > 0.0:
        return []
    deviation = (level - middle) / spread
    larger = np.exp(0.5 * level / np.sqrt(np.maximum(1, joints)))
    edges = np.cumsum([len(span[0]) for span in spans])[:-1]
    return [
        Windows(*span, of_deviation, of_larger)
        for span, of_deviation, of_larger in zip(
            spans, np.split(deviation, edges), np.split(larger, edges), strict=True
        )
    ]


def bursts_beyond(found: Sequence[Windows], deviation: float, larger: float = 0.0) -> list[list[Burst]]:
    """Windows beyond a deviation [σ] and a ratio, by segment; none where they hold more than `MOST_TIME`."""
    bursts, inside, total = [], 0.0, 0.0
    for of_segment in found:
        high = np.flatnonzero((of_segment.deviation > deviation) & (of_segment.larger > larger))
        spans: list[Burst] = []
        for start, stop in zip(of_segment.start[high], of_segment.stop[high], strict=True):
            if spans and start - spans[-1].stop < APART:
                spans[-1] = Burst(spans[-1].start, float(stop))
            else:
                spans.append(Burst(float(start), float(stop)))
        bursts.append(spans)
        inside += sum(span.stop - span.start for span in spans)
        total += float(of_segment.stop[-1] - of_segment.start[0]) if len(of_segment.start) else 0.0
    return bursts if inside <= MOST_TIME * total else [[] for _ in bursts]


def _width(part: TorqueSeries) -> int:
    """Samples of a window."""
    period = float(part.time[1] - part.time[0]) if len(part.time) > 1 else WINDOW
    return max(1, round(WINDOW / period))


def _spans(part: TorqueSeries) -> tuple[FloatArray, FloatArray]:
    """First and last stamps of a segment's windows."""
    width = _width(part)
    count = max(0, len(part.time) - width + 1)
    return part.time[:count], part.time[len(part.time) - count :]


def _means(part: TorqueSeries, slow: FloatArray) -> FloatArray:
    """(n, K) mean squared residual of each joint over each window, nan where too little of it counts."""
    width = _width(part)
    if len(part.time) < width:
        return np.empty((len(part.measured), 0))
    near = np.abs(part.velocity) < slow[:, None]
    near[:, 1:] |= np.sign(part.velocity[:, 1:]) != np.sign(part.velocity[:, :-1])
    around = np.ones(2 * max(1, round(REVERSAL * width / WINDOW)) + 1)
    near = np.array([np.convolve(row, around, "same")[: len(row)] > 0.5 for row in near.astype(np.float64)])
    counted = part.counted & ~near
    sums, counts = (
        np.array([np.convolve(row, np.ones(width), "valid") for row in rows])
        for rows in (np.where(counted, part.residual**2, 0.0), counted.astype(np.float64))
    )
    return np.where(counts >= COUNTED * width, sums / np.maximum(counts, 1.0), np.nan)


def _touched(span: tuple[FloatArray, FloatArray], bursts: Sequence[Burst]) -> BoolArray:
    """(K,) windows that hold a part of a burst."""
    touched = np.zeros(len(span[0]), dtype=np.bool_)
    for burst in bursts:
        touched |= (span[0] <= burst.stop) & (span[1] >= burst.start)
    return touched


def _median(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else 0.0
