"""A panel of values with their 95 % intervals, a row per name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.report.figures.figures import RESIDUAL, plain
from ident.report.figures.panels import Panel
from ident.report.figures.traces import points_trace
from ident.verdict.evidence import known

ROW = 15
"""Height of a row [px]."""


@dataclass(frozen=True)
class IntervalSeries:
    """Values of some rows.

    Attributes:
        label: in the legend.
        values: row → value.
        marker: its style, as plotly.js takes it.
        deviations: row → σ; without one, or where it is not finite, a value has no interval.
        shown: whether the legend names it.
    """

    label: str
    values: Mapping[str, float | None]
    marker: Mapping[str, Any]
    deviations: Mapping[str, float | None] | None = None
    shown: bool = True


def interval_panel(
    name: str, heading: str, rows: Sequence[str], series: Sequence[IntervalSeries], unit: str, **axis: Any
) -> Panel:
    """The panel.

    Args:
        name: what it shows, for files of its data.
        heading: above it.
        rows: names, from top to bottom.
        series: their values.
        unit: of the values.
        axis: further keys of the axis of the values.
    """
    return Panel(
        name,
        heading,
        [_trace(entry, rows, unit) for entry in series],
        x=axis,
        y={
            "type": "category",
            "categoryorder": "array",
            "categoryarray": [plain(row) for row in rows],
            "range": [len(rows) - 0.4, -0.6],
            "dtick": 1,
            "tickfont": {"size": 10},
            "automargin": True,
        },
        vertical=[(0.0, {"color": RESIDUAL, "width": 1})],
        height=ROW * len(rows) + 16,
    )


def _trace(series: IntervalSeries, rows: Sequence[str], unit: str) -> dict[str, Any]:
    having = [row for row in rows if known(series.values.get(row)) is not None]
    trace: dict[str, Any] = points_trace(
        [series.values[row] for row in having],
        [plain(row) for row in having],
        dict(series.marker),
        f"{series.label} of %{{y}}: %{{x:.4g}} {unit}<extra></extra>",
        name=series.label,
        showlegend=series.shown,
    )
    if series.deviations is not None:
        half = [WITHIN_95_PERCENT * (known(series.deviations.get(row)) or 0.0) for row in having]
        error = {"type": "data", "array": half, "thickness": 1.5, "width": 3}
        trace["error_x"] = {**error, "color": series.marker.get("color", RESIDUAL)}
    return trace
