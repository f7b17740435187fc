"""Positions, velocities and temperatures of the data that were used."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from drivers.core.arrays import FloatArray
from drivers.core.units import joint_unit
from ident.report.figures.figures import (
    ACCENT,
    BOTTOM,
    LOG_AXIS,
    MEASURED,
    PREDICTED,
    SERIES_COLOURS,
    TOP,
    Figure,
    base_layout,
    bold,
    plain,
    shortened,
    titled,
)
from ident.report.figures.panels import TIME_AXIS, Panel, panel_figure
from ident.report.figures.traces import Timeline, broken_line, curve_trace, lay_out, legend
from ident.report.recorded_runs import MotionSegment, TemperatureSeries
from ident.report.section import ReportData, ReportSection, Tile
from ident.result.schema import Result
from ident.views.number_text import number

VALUES_PANEL = 260
PAGE_POINTS = 8_000
MOST_POINTS = 2000
PANEL, TEMPERATURE_PANEL = 110, 200


def excitation_section(data: ReportData) -> ReportSection:
    """Condition numbers, singular values, parameters without excitation."""
    result = data.result
    excitation = result.excitation
    context = {
        "tiles": [
            Tile("Condition of W", number(excitation.condition, 3), "depends on units"),
            Tile("Condition number", number(excitation.scaled_condition, 3), "columns of unit length"),
            Tile("Not excited", str(len(excitation.unexcited)), f"of {len(result.base_parameters)} base parameters"),
            Tile("Rank margin", number(result.rank_margin, 3), "smallest singular value kept / largest dropped"),
        ],
        "unexcited": excitation.unexcited,
        "figure": _figure(result),
    }
    return ReportSection("Excitation", "excitation", "excitation.html.j2", context)


def _figure(result: Result) -> Figure | None:
    values = [value for value in result.excitation.singular_values if 0 < value < math.inf]
    if not values:
        return None
    height = TOP + BOTTOM + VALUES_PANEL
    line, marker = {"color": ACCENT, "width": 1}, {"size": 6, "color": ACCENT}
    hover = "no. %{x}: %{y:.3g}<extra></extra>"
    data = [curve_trace(range(1, len(values) + 1), values, line, hover, marker=marker)]
    layout = base_layout(
        height,
        showlegend=False,
        xaxis={**titled("number"), "zeroline": False},
        yaxis={**LOG_AXIS, **titled("singular value")},
    )
    caption = (
        "Singular values of the column-normalised W; their largest ratio is the condition number. A "
        "sharp drop at the end shows combinations of parameters that this motion makes poorly identifiable."
    )
    return Figure("singular-values-plot", height, data, layout, caption)


def section(data: ReportData) -> ReportSection | None:
    """Positions and velocities per joint, temperatures where they were recorded; None without either."""
    recorded = data.recorded
    if not recorded.motion and not recorded.temperatures:
        return None
    context = {
        "motion": _motion(data.result, recorded.motion) if recorded.motion else None,
        "temperatures": _temperatures(recorded.temperatures) if recorded.temperatures else None,
    }
    return ReportSection("Motion", "motion", "motion.html.j2", context)


def _motion(result: Result, segments: Sequence[MotionSegment]) -> Figure:
    joints = result.joints
    timeline = lay_out([segment.time for segment in segments])
    points = min(MOST_POINTS, PAGE_POINTS // (4 * len(joints)))
    rows = [
        [
            _panel(
                result, joint, "position", [segment.position[joint] for segment in segments], segments, timeline, points
            ),
            _panel(
                result, joint, "velocity", [segment.velocity[joint] for segment in segments], segments, timeline, points
            ),
        ]
        for joint in range(len(joints))
    ]
    caption = (
        "Filtered positions and the velocities derived from them (or recorded, where the preprocessing says so), "
        f"as the regressor uses them; each line has about {points} points at most, all peaks kept."
    )
    return panel_figure("motion-plot", rows, caption, linked=True, hovermode="x")


def _panel(
    result: Result,
    joint: int,
    quantity: str,
    values: Sequence[FloatArray],
    segments: Sequence[MotionSegment],
    timeline: Timeline,
    points: int,
) -> Panel:
    joints = result.joints
    unit = joint_unit({"position": "rad", "velocity": "rad/s"}[quantity], sliding=result.sliding[joint])
    traces: list[dict[str, Any]] = []
    for held_out, label, colour in ((False, "identification", MEASURED), (True, "validation", PREDICTED)):
        kept = [index for index, segment in enumerate(segments) if segment.held_out == held_out]
        if not kept:
            continue
        x, y = broken_line(
            [segments[index].time + timeline.offsets[index] for index in kept],
            [values[index] for index in kept],
            points,
        )
        traces.append(
            curve_trace(
                x,
                y,
                {"color": colour, "width": 1.3},
                f"%{{y:.4g}} {unit}",
                **legend(label, shown=joint == 0 and quantity == "position"),
            )
        )
    name = bold(joints[joint])
    return Panel(
        f"{joints[joint]}: {quantity} [{unit}]",
        f"{name}: position [{unit}]" if quantity == "position" else f"velocity [{unit}]",
        traces,
        f"{name}: {quantity} [{unit}]",
        x=TIME_AXIS,
        y={"nticks": 4},
        height=PANEL,
    )


def _temperatures(channels: Sequence[TemperatureSeries]) -> Figure:
    rows = []
    for name in dict.fromkeys(channel.name for channel in channels):
        parts = [channel for channel in channels if channel.name == name]
        timeline = lay_out([segment.time for segment in parts])
        times = [segment.time + offset for segment, offset in zip(parts, timeline.offsets, strict=True)]
        traces = []
        for index, column in enumerate(dict.fromkeys(column for segment in parts for column in segment.columns)):
            having = [k for k, segment in enumerate(parts) if column in segment.columns]
            values = [parts[k].values[:, parts[k].columns.index(column)] for k in having]
            x, y = broken_line([times[k] for k in having], values, MOST_POINTS)
            traces.append(
                curve_trace(
                    x,
                    y,
                    {"color": SERIES_COLOURS[index % len(SERIES_COLOURS)], "width": 1.3},
                    "%{y:.2f} °C",
                    name=plain(shortened(column, 24)),
                )
            )
        rows.append([Panel(name, bold(name, 32), traces, x=TIME_AXIS, y=titled("°C"), height=TEMPERATURE_PANEL)])
    caption = "As recorded. Friction falls as gears and grease warm up; the parameters hold for these temperatures."
    return panel_figure("temperature-plot", rows, caption, hovermode="x unified")
