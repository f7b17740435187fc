"""A figure of many plots: a grid of panels in a window, one below the other on a phone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.report.figures.figures import (
    BOTTOM,
    NARROW_TOP,
    RESIDUAL,
    TOP,
    Figure,
    axis_name,
    axis_ref,
    base_layout,
    category_axis,
    narrow_layout,
    note,
    plain,
)
from ident.report.figures.traces import points_trace
from ident.verdict.evidence import known

TIME_AXIS: dict[str, Any] = {"title": {"text": "time [s]"}, "zeroline": False}
"""Abscissa of what is drawn over time."""

HEADING, EDGE, TICKS, TITLE = 24, 6, 22, 18
"""Room of a heading above a panel, and below it of nothing, of tick labels, of an axis title [px]."""

SMALL_PANEL = 66
"""Height of a panel of a figure at a glance [px]."""

WIDE_ROOM, ROOM = 700, 300
"""For a legend in a window, beside the tool bar, and on a phone [px]."""

UNDER_BAR = 26
"""Height of the tool bar [px]."""

LEGEND_MARK, LEGEND_LETTER, LEGEND_ROW = 50, 7, 19
"""Widths of an entry's line and of a letter, height of a row [px]."""

COLUMN_GAP = 0.07
"""Between two columns, relative to the plot's width: it holds the tick labels of the right one."""


Line = tuple[float, Mapping[str, Any]]
"""Where a line lies in a panel, and its style."""


@dataclass(frozen=True)
class Panel:
    """One plot with axes of its own."""

    name: str  # what it shows, for files of its data
    heading: str  # above it, in plotly's markup
    traces: Sequence[Mapping[str, Any]]  # without their axes
    stacked_heading: str = ""  # above it where panels stand one below the other; the same where empty
    # x, y: further keys of its axes
    x: Mapping[str, Any] = field(default_factory=dict)
    y: Mapping[str, Any] = field(default_factory=dict)
    # vertical, horizontal: lines across it, a position and a style each
    vertical: Sequence[Line] = ()
    horizontal: Sequence[Line] = ()
    height: int = 140  # [px]


def panel_figure(
    anchor: str, rows: Sequence[Sequence[Panel]], caption: str, *, linked: bool = False, **layout: Any
) -> Figure:
    """A figure of rows of panels, as wide as the first row; `linked` zooms all horizontal axes with one."""
    panels = [panel for row in rows for panel in row]
    data = [
        {**trace, "xaxis": axis_ref("x", k), "yaxis": axis_ref("y", k), "meta": {"panel": panel.name}}
        for k, panel in enumerate(panels, 1)
        for trace in panel.traces
    ]
    shapes = [shape for k, panel in enumerate(panels, 1) for shape in _lines(panel, k)]
    entries = [str(trace.get("name", "")) for trace in data if trace.get("showlegend", layout.get("showlegend", True))]
    top, narrow_top = (least + legend_rows(entries, room) for least, room in ((TOP, WIDE_ROOM), (NARROW_TOP, ROOM)))
    top += UNDER_BAR if legend_rows(entries, WIDE_ROOM) else 0
    wide, height = _arranged(rows, top, linked, stacked=False)
    below, narrow_height = _arranged([[panel] for panel in panels], narrow_top, linked, stacked=True)
    common = base_layout(height, shapes=shapes, **wide, **layout)
    if legend_rows(entries, WIDE_ROOM):  # it would reach below the tool bar, so it stands under it
        common["legend"] = {**common["legend"], "y": 1 - UNDER_BAR / height}
    narrow = narrow_layout(narrow_height)
    return Figure(
        anchor,
        height,
        data,
        {**common, "margin": {**common["margin"], "t": top}},
        caption,
        {**narrow, **below, "margin": {**narrow["margin"], "t": narrow_top}},
    )


def in_rows(panels: Sequence[Panel], columns: int = 2) -> list[Sequence[Panel]]:
    """Panels in rows of so many; the last row may be shorter."""
    return [panels[start : start + columns] for start in range(0, len(panels), columns)]


def legend_rows(entries: Sequence[str], room: int) -> int:
    """Height [px] of a legend's rows but the first; all entries are as wide as the widest."""
    widest = LEGEND_MARK + LEGEND_LETTER * max(map(len, entries), default=0)
    columns = max(1, int(room / widest))
    return LEGEND_ROW * (-(-len(entries) // columns) - 1) if entries else 0


def _arranged(rows: Sequence[Sequence[Panel]], top: int, linked: bool, *, stacked: bool) -> tuple[dict[str, Any], int]:
    """Axes and headings of the panels, and the figure's height [px]."""
    columns = max(len(row) for row in rows)
    ends = [_last_of_its_axis(rows, row, column) for row, column in _places(rows)]
    below = [_room_below(rows, row, linked) for row in range(len(rows))]
    heights = [max(panel.height for panel in row) for row in rows]
    inner = sum(heights) + sum(below[:-1]) + HEADING * (len(rows) - 1)
    width = (1.0 - COLUMN_GAP * (columns - 1)) / columns
    axes: dict[str, Any] = {}
    notes = []
    upper = float(inner)
    k = 0
    for row, panels in enumerate(rows):
        for column, panel in enumerate(panels):
            titled = ends[k]
            k += 1
            left = column * (width + COLUMN_GAP)
            domain = [max(0.0, (upper - panel.height) / inner), min(1.0, upper / inner)]
            axes[axis_name("x", k)] = {
                "nticks": 6,
                **panel.x,
                "domain": [left, min(1.0, left + width)],
                "anchor": axis_ref("y", k),
                **({} if titled else {"title": {"text": ""}}),
                **({"showticklabels": False} if linked and not titled else {}),
                **({"matches": "x"} if linked and k > 1 else {}),
            }
            axes[axis_name("y", k)] = {"nticks": 5, **panel.y, "domain": domain, "anchor": axis_ref("x", k)}
            heading = panel.stacked_heading or panel.heading if stacked else panel.heading
            notes.append(note(heading, left, domain[1], font={"size": 11 if stacked else 12}))
        upper -= heights[row] + below[row] + HEADING
    return {**axes, "annotations": notes}, top + BOTTOM + inner


def _places(rows: Sequence[Sequence[Panel]]) -> list[tuple[int, int]]:
    return [(row, column) for row, panels in enumerate(rows) for column in range(len(panels))]


def _last_of_its_axis(rows: Sequence[Sequence[Panel]], row: int, column: int) -> bool:
    """Return whether no panel below repeats this panel's horizontal axis."""
    if row + 1 == len(rows) or column >= len(rows[row + 1]):
        return True
    return rows[row][column].x.get("title") != rows[row + 1][column].x.get("title")


def _room_below(rows: Sequence[Sequence[Panel]], row: int, linked: bool) -> int:
    if any(_last_of_its_axis(rows, row, column) for column in range(len(rows[row]))):
        return TICKS + TITLE
    return EDGE if linked else TICKS


def _lines(panel: Panel, k: int) -> list[dict[str, Any]]:
    x, y = axis_ref("x", k), axis_ref("y", k)
    upright = [
        {"type": "line", "xref": x, "x0": at, "x1": at, "yref": f"{y} domain", "y0": 0, "y1": 1, "line": dict(line)}
        for at, line in panel.vertical
    ]
    level = [
        {"type": "line", "xref": f"{x} domain", "x0": 0, "x1": 1, "yref": y, "y0": at, "y1": at, "line": dict(line)}
        for at, line in panel.horizontal
    ]
    return upright + level


ROW = 15
"""Height of a row [px]."""


@dataclass(frozen=True)
class IntervalSeries:
    """Values of some rows."""

    label: str  # in the legend
    values: Mapping[str, float | None]  # row → value
    marker: Mapping[str, Any]  # its style, as plotly.js takes it
    # row → σ; without one, or where it is not finite, a value has no interval
    deviations: Mapping[str, float | None] | None = None
    shown: bool = True  # whether the legend names it


def interval_panel(
    name: str, heading: str, rows: Sequence[str], series: Sequence[IntervalSeries], unit: str, **axis: Any
) -> Panel:
    """The panel of `rows` from top to bottom, each with its values in `unit`; `axis` has further keys of their axis."""
    return Panel(
        name,
        heading,
        [_trace(entry, rows, unit) for entry in series],
        x=axis,
        y=category_axis([plain(row) for row in rows]),
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
