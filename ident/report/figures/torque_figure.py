"""Measured, predicted and residual torque of every joint over one zoomable time axis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.text import counted
from drivers.core.units import joint_unit
from ident.assessment.validation import Fit
from ident.regression.comparison import TorqueSeries
from ident.report.figures.figures import MEASURED, PREDICTED, RESIDUAL, Figure, bold, titled
from ident.report.figures.panels import SMALL_PANEL, TIME_AXIS, Panel, in_rows, panel_figure
from ident.report.figures.traces import broken_line, curve_trace, lay_out, legend, points_per_trace, points_trace
from ident.result.schema import Result
from ident.views.number_text import number, percent, whole

PANEL = 150
"""Height of a panel [px]."""

SMALL_POINTS = 300
"""Points of a line in the figure at a glance."""

LINES = {"residual": (3, RESIDUAL, 1.0), "measured": (1, MEASURED, 2.0), "predicted": (2, PREDICTED, 1.2)}
"""Line → its place in the legend, its colour and its width [px]; in the order in which they are drawn."""

LOW_WEIGHT = 0.5
"""An equation that a robust estimate weighs less is marked as rejected."""

REJECTED = "#CC79A7"


def torque_figure(
    anchor: str, result: Result, order: Sequence[int], series: Sequence[TorqueSeries], fit: Fit | None
) -> Figure | None:
    """One panel per joint, in the `order` of joint numbers; None where there is no sample to show."""
    shown = _judged(series)
    if not shown or not result.joints:
        return None
    points = points_per_trace(len(result.joints))
    drawing = _Drawing.of(result, shown, points, PANEL)
    rows = [
        [
            replace(
                drawing.panel(joint, ("residual", "measured", "predicted"), first=joint == order[0]),
                heading=drawing.heading(joint) + _errors(fit, joint, drawing.unit(joint)),
                stacked_heading=drawing.heading(joint, 20) + _errors_in_short(fit, joint, drawing.unit(joint)),
            )
        ]
        for joint in order
    ]
    caption = _caption(shown, points, len(drawing.borders))
    return panel_figure(anchor, rows, caption, linked=True, hovermode="x unified")


def small_torque_figure(
    anchor: str, result: Result, order: Sequence[int], series: Sequence[TorqueSeries], fit: Fit | None
) -> Figure | None:
    """Measured and predicted torque alone, two joints in a row: the same at a glance."""
    shown = _judged(series)
    if not shown or not result.joints:
        return None
    drawing = _Drawing.of(result, shown, SMALL_POINTS, SMALL_PANEL)
    panels = [
        replace(
            drawing.panel(joint, ("measured", "predicted"), first=joint == order[0]),
            y={},  # the unit is in the heading
            heading=drawing.heading(joint, 20) + _errors_in_short(fit, joint, drawing.unit(joint)),
        )
        for joint in order
    ]
    return panel_figure(anchor, in_rows(panels), "", linked=True, hovermode="x unified")


def _judged(series: Sequence[TorqueSeries]) -> list[TorqueSeries]:
    """The segments without their ends, where filters are not valid and which no figure counts."""
    ends = [np.flatnonzero(segment.used) for segment in series]
    return [segment.part(used[0], used[-1] + 1) for segment, used in zip(series, ends, strict=True) if len(used)]


@dataclass(frozen=True)
class _Drawing:
    """Segments on one axis of time, and how much of them is drawn."""

    result: Result  # names and units of the joints
    series: Sequence[TorqueSeries]  # the segments
    times: Sequence[FloatArray]  # (M,) of each [s], as shown
    borders: tuple[float, ...]  # shown times at which a segment begins that does not follow the one before
    points: int  # of a line, about
    height: int  # of a panel [px]

    @classmethod
    def of(cls, result: Result, series: Sequence[TorqueSeries], points: int, height: int) -> Self:
        timeline = lay_out([segment.time for segment in series])
        times = [segment.time + offset for segment, offset in zip(series, timeline.offsets, strict=True)]
        return cls(result, series, times, timeline.borders, points, height)

    def unit(self, joint: int) -> str:
        return joint_unit("N·m", sliding=self.result.sliding[joint])

    def heading(self, joint: int, letters: int = 60) -> str:
        return bold(self.result.joints[joint], letters)

    def panel(self, joint: int, lines: Sequence[str], *, first: bool) -> Panel:
        traces = [self._trace(joint, label, first) for label in lines]
        traces += _rejected(joint, self.times, self.series, self.points, first)
        return Panel(
            self.result.joints[joint],
            "",
            traces,
            x=TIME_AXIS,
            y=titled(self.unit(joint)),
            vertical=[(x, {"dash": "dot", "width": 1}) for x in self.borders],
            height=self.height,
        )

    def _trace(self, joint: int, label: str, first: bool) -> dict[str, Any]:
        rank, colour, width = LINES[label]
        values = [
            np.where(segment.counted[joint], segment.measured[joint] - segment.predicted[joint], np.nan)
            if label == "residual"
            else getattr(segment, label)[joint]
            for segment in self.series
        ]
        x, y = broken_line(self.times, values, self.points)
        return curve_trace(
            x,
            y,
            {"color": colour, "width": width},
            f"%{{y:.4g}} {self.unit(joint)}",
            legendrank=rank,
            **legend(label, shown=first),
        )


def _rejected(
    joint: int, times: Sequence[FloatArray], series: Sequence[TorqueSeries], points: int, first: bool
) -> list[dict[str, Any]]:
    """Markers on the torques that a robust estimate counted for less than half; none where all count alike."""
    if all(segment.weights is None for segment in series):
        return []
    x, y = [], []
    for time, segment in zip(times, series, strict=True):
        if segment.weights is not None:
            low = np.nan_to_num(segment.weights[joint], nan=1.0) < LOW_WEIGHT
            x.append(time[low])
            y.append(segment.measured[joint, low])
    every = slice(None, None, max(1, -(-sum(map(len, x)) // points)))
    return [
        points_trace(
            np.concatenate(x)[every],
            np.concatenate(y)[every],
            {"size": 5, "symbol": "x-thin", "line": {"color": REJECTED, "width": 1.2}},
            "rejected",
            legendrank=4,
            **legend("rejected", shown=first),
        )
    ]


def _errors(fit: Fit | None, joint: int, unit: str) -> str:
    if fit is None or joint >= min(len(fit.rmse), len(fit.joint_relative_error)):
        return ""
    return f"   RMSE {number(fit.rmse[joint], 3)} {unit}, relative error {percent(fit.joint_relative_error[joint])}"


def _errors_in_short(fit: Fit | None, joint: int, unit: str) -> str:
    if fit is None or joint >= min(len(fit.rmse), len(fit.joint_relative_error)):
        return ""
    return f"  {number(fit.rmse[joint], 2)} {unit}, {percent(fit.joint_relative_error[joint], 2)}"


def _caption(series: Sequence[TorqueSeries], points: int, borders: int) -> str:
    samples = sum(len(segment.time) for segment in series)
    text = [f"{whole(samples)} filtered samples in {counted(len(series), 'gap-free segment')}."]
    if samples > points:
        text.append(
            f"Each line is decimated to about {whole(points)} points, the smallest and the largest value of every "
            "interval, which keeps all peaks."
        )
    if not all(bool(segment.counted.all()) for segment in series):
        text.append("Samples not used (a joint at rest) have no residual.")
    if any(segment.weights is not None for segment in series):
        text.append(f"Rejected: the estimator gave the equation a weight below {LOW_WEIGHT:g}.")
    if borders:
        text.append(
            "Dotted: start of a segment that does not follow in time (another recording, or a pause of more than a "
            "minute)."
        )
    text.append("Time counts from the first sample shown. Drag to zoom, double-click to reset.")
    return " ".join(text)
