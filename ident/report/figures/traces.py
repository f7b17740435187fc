"""Long series on a page: decimated to their envelope, laid out in time, packed as base64.

Plotly.js reads {dtype, bdata} as a typed array; float32 takes a third of the same numbers in decimal digits.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import FloatArray

POINTS_PER_TRACE = 2000
"""A trace holds about this many points at most."""

PAGE_POINTS = 22_000
"""All torque traces of a page together, which keeps the file of an arm with many joints small."""

LONGEST_PAUSE = 60.0
"""Segments further apart than this [s] are drawn side by side."""

SIDE_BY_SIDE = 0.02
"""Space between segments drawn side by side, relative to their total length."""


@dataclass(frozen=True)
class Timeline:
    """Place of each series on the time axis."""

    offsets: tuple[float, ...]  # (S,) to be added to the series' own time [s]; the first sample is shown at 0
    borders: tuple[float, ...]  # shown times [s] at which a segment begins that does not follow the one before


def lay_out(times: Sequence[FloatArray]) -> Timeline:
    """Keep short gaps of times [s] as they are; draw side by side what another recording or a long pause separates."""
    length = sum(float(time[-1] - time[0]) for time in times if len(time))
    offsets, borders = [], []
    offset, end = 0.0, None
    for time in times:
        if len(time):
            start = float(time[0])
            if end is None:
                offset = -start
            elif not 0.0 <= start + offset - end <= LONGEST_PAUSE:
                border = end + SIDE_BY_SIDE * length
                offset = border - start
                borders.append(border)
            end = float(time[-1]) + offset
        offsets.append(offset)
    return Timeline(tuple(offsets), tuple(borders))


def envelope_indices(values: FloatArray, points: int) -> npt.NDArray[np.int64]:
    """Samples to keep of a series (M,) so that at most about `points` are left and no extreme value is lost.

    Of each bin of equal length the smallest and the largest value stay, in the order of time, and both ends. A bin's
    last sample that is nan stays too: it is a gap in the line.
    """
    length = len(values)
    if length <= max(points, 4):
        return np.arange(length)
    bins = max(1, (points - 2) // 2)
    width = -(-length // bins)
    bins = -(-length // width)
    padded = np.full(bins * width, np.nan)
    padded[:length] = values
    table = padded.reshape(bins, width)
    first = np.arange(bins) * width
    smallest = first + np.argmin(np.where(np.isnan(table), np.inf, table), axis=1)
    largest = first + np.argmax(np.where(np.isnan(table), -np.inf, table), axis=1)
    last = np.minimum(first + width, length) - 1
    gaps = last[np.isnan(values[last])]
    return np.unique(np.concatenate([[0, length - 1], smallest, largest, gaps]))


def broken_line(
    times: Sequence[FloatArray], values: Sequence[FloatArray], points: int
) -> tuple[FloatArray, FloatArray]:
    """One trace (x, y) of several segments, each cut down to its share of `points`, with nan between them."""
    total = sum(len(segment) for segment in values)
    x: list[FloatArray] = []
    y: list[FloatArray] = []
    for time, segment in zip(times, values, strict=True):
        if not len(segment):
            continue
        if x:
            x.append(time[:1])
            y.append(np.array([np.nan]))
        kept = envelope_indices(segment, points if total <= points else points * len(segment) // total)
        x.append(time[kept])
        y.append(segment[kept])
    return (np.concatenate(x), np.concatenate(y)) if x else (np.empty(0), np.empty(0))


def points_per_trace(dof: int) -> int:
    """Points that each of the three traces a joint, of fit and of validation, may have."""
    return min(POINTS_PER_TRACE, max(200, PAGE_POINTS // (6 * max(1, dof))))


def some_of(samples: npt.NDArray[np.int64], points: int) -> npt.NDArray[np.int64]:
    """At most `points` of the samples, in their order: random ones, since a stride could fall in step with a motion."""
    if len(samples) <= points:
        return samples
    return np.sort(np.random.default_rng(0).choice(samples, points, replace=False))


def legend(name: str, *, shown: bool) -> dict[str, Any]:
    """Keys of a trace whose entry in the legend stands for all traces of its name; one of them is `shown` there."""
    return {"name": name, "legendgroup": name, "showlegend": shown}


def packed(values: npt.ArrayLike) -> dict[str, str]:
    """Values (M,) as plotly.js' typed array; nan stays nan, a gap in a line."""
    most = float(np.finfo(np.float32).max)  # absurd recorded values must not overflow
    raw = np.clip(np.asarray(values, dtype=np.float64), -most, most).astype("<f4").tobytes()
    return {"dtype": "f4", "bdata": base64.b64encode(raw).decode("ascii")}


Values = np.ndarray | Sequence[object]


def curve_trace(x: Values, y: Values, line: Mapping[str, Any], hover: str = "", **further: Any) -> dict[str, Any]:
    """A line of a figure through x and y (M,), which are packed where they are arrays; styles in Plotly's keys.

    `hover` is the template of the text at the pointer, `further` are other keys of the trace; with a `marker` among
    them the line has points.
    """
    return _scatter("lines+markers" if "marker" in further else "lines", x, y, hover) | {"line": line, **further}


def points_trace(x: Values, y: Values, marker: Mapping[str, Any], hover: str = "", **further: Any) -> dict[str, Any]:
    """Points of a figure; arguments as of `curve_trace`, `marker` their style."""
    return _scatter("markers", x, y, hover) | {"marker": marker, **further}


def _scatter(mode: str, x: Values, y: Values, hover: str) -> dict[str, Any]:
    values = {axis: packed(data) if isinstance(data, np.ndarray) else list(data) for axis, data in (("x", x), ("y", y))}
    return {"type": "scatter", "mode": mode, **values, **({"hovertemplate": hover} if hover else {"hoverinfo": "skip"})}
