"""Measured, predicted and residual torque of every joint over one zoomable time axis."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ident.regression.comparison import TorqueSeries
from ident.report.figures import (
    BOTTOM,
    MEASURED,
    PREDICTED,
    RESIDUAL,
    TOP,
    Figure,
    axis_name,
    axis_ref,
    base_layout,
    note,
    plain,
    row_domains,
    vertical_line,
)
from ident.report.number_text import number, percent, whole
from ident.report.traces import broken_line, lay_out, packed, points_per_trace
from ident.result.schema import Fit

PANEL, GAP = 150, 30


def torque_figure(anchor: str, joints: Sequence[str], series: Sequence[TorqueSeries], fit: Fit | None) -> Figure | None:
    """One panel a joint; None where there is no sample to show."""
    series = [segment for segment in series if len(segment.time)]
    if not series or not joints:
        return None
    timeline = lay_out(series)
    times = [segment.time + offset for segment, offset in zip(series, timeline.offsets, strict=True)]
    height = TOP + BOTTOM + PANEL * len(joints) + GAP * (len(joints) - 1)
    domains = row_domains(len(joints), height, GAP)
    points = points_per_trace(len(joints))
    data: list[dict[str, Any]] = []
    axes: dict[str, Any] = {
        "xaxis": {"title": {"text": "time [s]"}, "anchor": axis_ref("y", len(joints)), "zeroline": False}
    }
    notes = []
    for joint, (name, domain) in enumerate(zip(joints, domains, strict=True)):
        axes[axis_name("y", joint + 1)] = {"title": {"text": "N·m"}, "domain": list(domain), "anchor": "x", "nticks": 5}
        notes.append(note(f"<b>{plain(name)}</b>{_figures(fit, joint)}", 0, domain[1]))
        residuals = [
            np.where(segment.used, segment.measured[joint] - segment.predicted[joint], np.nan) for segment in series
        ]
        lines = (
            ("residual", 3, residuals, RESIDUAL, 1.0),
            ("measured", 1, [segment.measured[joint] for segment in series], MEASURED, 2.0),
            ("predicted", 2, [segment.predicted[joint] for segment in series], PREDICTED, 1.2),
        )
        for label, rank, values, colour, width in lines:
            x, y = broken_line(times, values, points)
            data.append(
                {
                    "type": "scatter",
                    "mode": "lines",
                    "name": label,
                    "legendgroup": label,
                    "legendrank": rank,
                    "showlegend": joint == 0,
                    "x": packed(x),
                    "y": packed(y),
                    "xaxis": "x",
                    "yaxis": axis_ref("y", joint + 1),
                    "line": {"color": colour, "width": width},
                    "hovertemplate": "%{y:.4g} N·m",
                }
            )
    borders = [vertical_line(x, dash="dot", width=1) for x in timeline.borders]
    layout = base_layout(height, hovermode="x unified", annotations=notes, shapes=borders, **axes)
    return Figure(anchor, height, data, layout, _caption(series, points, len(timeline.borders)))


def _figures(fit: Fit | None, joint: int) -> str:
    if fit is None or joint >= min(len(fit.rmse), len(fit.joint_relative_error)):
        return ""
    return f"   RMSE {number(fit.rmse[joint], 3)} N·m, relative error {percent(fit.joint_relative_error[joint])}"


def _caption(series: Sequence[TorqueSeries], points: int, borders: int) -> str:
    samples = sum(len(segment.time) for segment in series)
    text = [f"{whole(samples)} filtered samples in {len(series)} gap-free segment{'s' if len(series) > 1 else ''}."]
    if samples > points:
        text.append(
            f"Each line is decimated to about {whole(points)} points, the smallest and the largest value of every "
            "interval, which keeps all peaks."
        )
    if not all(bool(segment.used.all()) for segment in series):
        text.append("Samples not used (the arm at rest, the ends of a segment) have no residual.")
    if borders:
        text.append(
            "Dotted: start of a segment that does not follow in time (another recording, or a pause of more than a "
            "minute)."
        )
    text.append("Time counts from the first sample shown. Drag to zoom, double-click to reset.")
    return " ".join(text)
