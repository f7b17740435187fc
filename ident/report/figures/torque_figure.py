"""Measured, predicted and residual torque of every joint over one zoomable time axis."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.units import joint_unit
from ident.assessment.validation import Fit
from ident.regression.comparison import TorqueSeries
from ident.report.figures.figures import MEASURED, PREDICTED, RESIDUAL, Figure, plain, shortened
from ident.report.figures.panels import Panel, panel_figure
from ident.report.figures.traces import broken_line, curve_trace, lay_out, points_per_trace, points_trace
from ident.result.schema import Result
from ident.views.number_text import number, percent, whole

PANEL = 150
"""Height of a panel [px]."""

LOW_WEIGHT = 0.5
"""An equation that a robust estimate weighs less is marked as rejected."""

REJECTED = "#CC79A7"


def torque_figure(
    anchor: str, result: Result, order: Sequence[int], series: Sequence[TorqueSeries], fit: Fit | None
) -> Figure | None:
    """One panel per joint, in the `order` of joint numbers; None where there is no sample to show."""
    joints, series = result.joints, [segment for segment in series if len(segment.time)]
    if not series or not joints:
        return None
    timeline = lay_out([segment.time for segment in series])
    times = [segment.time + offset for segment, offset in zip(series, timeline.offsets, strict=True)]
    points = points_per_trace(len(joints))
    borders = [(x, {"dash": "dot", "width": 1}) for x in timeline.borders]
    panels = []
    for joint in order:
        unit = joint_unit("N·m", sliding=result.sliding[joint])
        residuals = [
            np.where(segment.counted[joint], segment.measured[joint] - segment.predicted[joint], np.nan)
            for segment in series
        ]
        lines = (
            ("residual", 3, residuals, RESIDUAL, 1.0),
            ("measured", 1, [segment.measured[joint] for segment in series], MEASURED, 2.0),
            ("predicted", 2, [segment.predicted[joint] for segment in series], PREDICTED, 1.2),
        )
        traces = []
        for label, rank, values, colour, width in lines:
            x, y = broken_line(times, values, points)
            traces.append(
                curve_trace(
                    x,
                    y,
                    {"color": colour, "width": width},
                    f"%{{y:.4g}} {unit}",
                    name=label,
                    legendgroup=label,
                    legendrank=rank,
                    showlegend=joint == order[0],
                )
            )
        traces += _rejected(joint, times, series, points, joint == order[0])
        name = joints[joint]
        panels.append(
            Panel(
                name,
                f"<b>{plain(name)}</b>{_errors(fit, joint, unit)}",
                traces,
                f"<b>{plain(shortened(name, 20))}</b>{_errors_in_short(fit, joint, unit)}",
                x={"title": {"text": "time [s]"}, "zeroline": False},
                y={"title": {"text": unit}},
                vertical=borders,
                height=PANEL,
            )
        )
    caption = _caption(series, points, len(timeline.borders))
    return panel_figure(anchor, [[panel] for panel in panels], caption, linked=True, hovermode="x unified")


def _rejected(
    joint: int, times: Sequence[FloatArray], series: Sequence[TorqueSeries], points: int, legend: bool
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
            name="rejected",
            legendgroup="rejected",
            legendrank=4,
            showlegend=legend,
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
    text = [f"{whole(samples)} filtered samples in {len(series)} gap-free segment{'s' if len(series) > 1 else ''}."]
    if samples > points:
        text.append(
            f"Each line is decimated to about {whole(points)} points, the smallest and the largest value of every "
            "interval, which keeps all peaks."
        )
    if not all(bool(segment.counted.all()) for segment in series):
        text.append("Samples not used (a joint at rest, the ends of a segment) have no residual.")
    if any(segment.weights is not None for segment in series):
        text.append(f"Rejected: the estimator gave the equation a weight below {LOW_WEIGHT:g}.")
    if borders:
        text.append(
            "Dotted: start of a segment that does not follow in time (another recording, or a pause of more than a "
            "minute)."
        )
    text.append("Time counts from the first sample shown. Drag to zoom, double-click to reset.")
    return " ".join(text)
