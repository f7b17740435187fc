"""Short stretches in which the torque leaves the model by far: contacts, collisions, a cable, a hand on the arm.

A model that lacks something leaves a residual that returns with the motion. A contact leaves a burst of some tenths of
a second, many times the usual residual, and bends the whole fit. So bursts are looked for in the residuals of the fit,
and believed where a fit without them is clearly better everywhere else (`bends_fit`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from drivers.streams import FloatArray
from ident.regression.comparison import TorqueSeries

WINDOW = 0.3
"""[s] over which the squared residuals are averaged: shorter peaks are outliers or velocity reversals."""

LEVEL = 9.0
"""Mean of the squared residuals over a window, in units of their usual size, from which on it is part of a burst."""

MOST_TIME = 0.25
"""Share of the time beyond which bursts are no exceptions, and the model is wrong."""

APART = 0.5
"""[s]; bursts that are closer are one."""

BETTER = 1.15
"""Factor by which the residuals outside bursts fall without these, from which on they bend the fit; where a model lacks
something they fall by 1.10 (UR10)."""

LARGER = 3.0
"""Residuals within over those outside, of the fit without bursts; 2.6 where a model lacks something (UR10)."""

_MEDIAN_OF_NORMAL = 0.6745


@dataclass(frozen=True)
class Burst:
    """A stretch of large residuals, by its first and last stamp [s] in its recording's clock."""

    start: float
    stop: float

    def within(self, time: FloatArray) -> npt.NDArray[np.bool_]:
        """(M,) which of some stamps [s] it holds."""
        return np.asarray((time >= self.start) & (time <= self.stop))


def residual_bursts(series: Sequence[TorqueSeries], torques: Sequence[int]) -> tuple[list[Burst], ...]:
    """Bursts of each segment; none where they hold more than `MOST_TIME`.

    Args:
        series: measured and predicted torques, one per segment.
        torques: indices of the motors whose torques are used.
    """
    chosen = list(torques)
    residual = [part.residual[chosen] for part in series]
    counted = [part.counted[chosen] for part in series]
    rows = zip(np.concatenate(residual, axis=1), np.concatenate(counted, axis=1), strict=True)
    usual = np.array([_usual(row[mask]) for row, mask in rows])[:, None]
    found = []
    for part, values, mask in zip(series, residual, counted, strict=True):
        relative = np.divide(values**2, usual**2, out=np.zeros_like(values), where=usual > 0.0)
        found.append(_of_series(part.time, relative.sum(axis=0) / np.maximum(1, mask.sum(axis=0)), part.used))
    inside = sum(int(np.sum(_inside(part, bursts) & part.used)) for part, bursts in zip(series, found, strict=True))
    few = inside <= MOST_TIME * sum(int(part.used.sum()) for part in series)
    return tuple(bursts if few else [] for bursts in found)


def bends_fit(
    before: Sequence[TorqueSeries], after: Sequence[TorqueSeries], bursts: Sequence[list[Burst]], torques: Sequence[int]
) -> float | None:
    """How many times the usual residual the bursts are, if they bend the fit; else None.

    Args:
        before: torques of the fit to all data.
        after: those of the fit without the bursts, on all data.
        bursts: of each segment.
        torques: indices of the motors whose torques are used.
    """
    outside = _sizes(before, bursts, torques, inside=False), _sizes(after, bursts, torques, inside=False)
    within = _sizes(after, bursts, torques, inside=True)
    shown = (outside[0] > 0.0) & (outside[1] > 0.0) & (within > 0.0)
    if not shown.any():
        return None
    better, larger = (
        float(np.exp(np.mean(np.log(first[shown] / second[shown]))))
        for first, second in ((outside[0], outside[1]), (within, outside[1]))
    )
    return larger if better >= BETTER and larger >= LARGER else None


def _inside(part: TorqueSeries, bursts: Sequence[Burst]) -> npt.NDArray[np.bool_]:
    """(M,) samples of a segment within bursts."""
    inside = np.zeros(len(part.time), dtype=np.bool_)
    for burst in bursts:
        inside |= burst.within(part.time)
    return inside


def _sizes(
    series: Sequence[TorqueSeries], bursts: Sequence[list[Burst]], torques: Sequence[int], *, inside: bool
) -> FloatArray:
    """Root mean square (k,) of the residuals of each motor inside or outside the bursts."""
    chosen, squares, counts = list(torques), 0.0, 0.0
    for part, of_part in zip(series, bursts, strict=True):
        here = part.counted[chosen] & (_inside(part, of_part) == inside)
        squares = squares + np.sum(np.where(here, part.residual[chosen] ** 2, 0.0), axis=1)
        counts = counts + here.sum(axis=1)
    return np.asarray(np.sqrt(squares / np.maximum(counts, 1.0)))


def _usual(residual: FloatArray) -> float:
    """Standard deviation of a joint's residuals, from the median of their size, which bursts hardly change."""
    return float(np.median(np.abs(residual))) / _MEDIAN_OF_NORMAL if len(residual) else 0.0


def _of_series(time: FloatArray, squares: FloatArray, used: npt.NDArray[np.bool_]) -> list[Burst]:
    """Bursts of one segment with relative squared residuals (M,)."""
    if len(time) < 2:
        return []
    period = float(time[1] - time[0])
    width = min(len(time), max(1, round(WINDOW / period)))
    sums = np.concatenate([[0.0], np.cumsum(np.where(used, squares, 0.0))])
    high = (sums[width:] - sums[:-width]) / width > LEVEL
    edges = np.flatnonzero(np.diff(np.concatenate([[False], high, [False]]).astype(np.int8))).reshape(-1, 2)
    spans: list[tuple[int, int]] = []
    for start, stop in edges.tolist():
        end = stop - 1 + width
        if spans and start - spans[-1][1] < APART / period:
            spans[-1] = (spans[-1][0], end)
        else:
            spans.append((start, end))
    return [Burst(float(time[start]), float(time[end - 1])) for start, end in spans]
