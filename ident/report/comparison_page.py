"""The page of a comparison of methods: one self-contained HTML file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ident.assessment.validation import LOW_SPEED
from ident.experiments.method_comparison import JointGroup
from ident.report.figures.figures import MEASURED, PREDICTED, Figure, category_axis, plain
from ident.report.figures.panels import ROW, Panel, panel_figure
from ident.report.figures.traces import points_trace
from ident.report.html_file import rendered
from ident.result.tables import Table

Errors = tuple[str, Sequence[float]]
"""A model's label, and its RMSE on each held-out recording [N·m]."""


def comparison_page(
    robot: str,
    recordings: Sequence[str],
    groups: Sequence[JointGroup],
    tables: Sequence[Table],
    errors: Sequence[Errors],
    unit: str,
    failures: Sequence[str],
) -> str:
    """The page: tables, the errors in `unit` as a figure, and which methods gave no model."""
    return rendered(
        "comparison_page",
        robot=robot,
        recordings=recordings,
        groups=groups,
        tables=[table for table in tables if len(table)],
        figure=comparison_figure(errors, unit),
        failures=failures,
        low_speed=LOW_SPEED,
        speed_unit="rad/s" if unit == "N·m" else "m/s" if unit == "N" else "rad/s or m/s",
    )


def comparison_figure(errors: Sequence[Errors], unit: str) -> Figure:
    """A row per model: its error on every recording, and the mean."""
    runs: list[tuple[str, float]] = [(plain(label), value) for label, of in errors for value in of]
    means = [(plain(label), float(np.nanmean(of))) for label, of in errors]
    circle = {"color": MEASURED, "symbol": "circle-open", "size": 6}
    several = len(runs) > len(means)
    panel = Panel(
        "RMSE",
        "<b>RMSE of the held-out torque</b>, all joints together",
        [
            *([_points("a recording", runs, unit, circle)] if several else []),
            _points("mean" if several else "RMSE", means, unit, {"color": PREDICTED, "symbol": "diamond", "size": 9}),
        ],
        x={"title": {"text": unit}, "rangemode": "tozero"},
        y=category_axis([label for label, _ in means]),
        height=2 * ROW * len(means) + 16,
    )
    caption = "Each circle is one held-out recording. Models that differ less than their circles scatter may still "
    caption += "differ significantly: compare them recording by recording, as the table of differences does."
    if not several:
        caption = "One held-out recording does not show whether a difference is significant: give several."
    return panel_figure("rmse-plot", [[panel]], caption)


def _points(label: str, points: Sequence[tuple[str, float]], unit: str, marker: dict[str, Any]) -> dict[str, Any]:
    finite = [(name, value) for name, value in points if np.isfinite(value)]
    return points_trace(
        [value for _, value in finite],
        [name for name, _ in finite],
        marker,
        f"%{{y}}, {label}: %{{x:.4g}} {unit}<extra></extra>",
        name=label,
    )
