"""How an iterative estimator converged, and which equations it rejected (AUBO Figs. 10 and 11)."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle

from ident.estimators.estimator import EstimationLoop
from ident.report.figures.figures import LOG_AXIS, SERIES_COLOURS, Figure, plain, titled
from ident.report.figures.panels import Panel, in_rows, panel_figure
from ident.report.figures.traces import curve_trace, legend
from ident.report.section import ReportData, ReportSection
from ident.result.schema import Convergence

PANEL = 180
FEW = 6
"""Iterations whose ticks are all shown: between them plotly would put fractions."""


def section(data: ReportData) -> ReportSection | None:
    """Each loop's convergence, the equations per joint; None for methods that solve in one step."""
    convergence = data.result.convergence
    if convergence is None:
        return None
    context = {
        "passes": convergence.passes,
        "open": [loop.name for loop in convergence.loops if not loop.settled],
        "figure": _figure(convergence),
        "equations": convergence.equations,
        "joints": [equation.joint for equation in convergence.equations],
        "correlation": convergence.joint_correlation,
    }
    return ReportSection("Convergence", "convergence", "convergence.html.j2", context)


def _figure(convergence: Convergence) -> Figure | None:
    by_name: dict[str, list[EstimationLoop]] = {}
    for loop in convergence.loops:
        if loop.values:
            by_name.setdefault(loop.name, []).append(loop)
    joints = list(dict.fromkeys(loop.joint for loop in convergence.loops if loop.joint and loop.values))
    first = next((name for name, loops in by_name.items() if loops[0].joint), "")
    colours = dict(zip(joints, cycle(SERIES_COLOURS), strict=False))
    panels = [_panel(loops, colours, first=name == first) for name, loops in by_name.items()]
    if not panels:
        return None
    caption = "Each loop over its iterations, innermost first; a loop has converged where its values no longer change."
    return panel_figure("convergence-plot", in_rows(panels), caption, showlegend=bool(first))


def _panel(loops: list[EstimationLoop], colours: Mapping[str, str], *, first: bool) -> Panel:
    """One loop, or the same one of several joints, each in its colour."""
    name, unit = loops[0].name, loops[0].unit
    values = [value for loop in loops for value in loop.values if value is not None]
    changes = all(value > 0 for value in values) and max(values, default=1.0) > 30.0 * min(values, default=1.0)
    traces = [
        curve_trace(
            range(1, len(loop.values) + 1),
            loop.values,
            {"color": colours.get(loop.joint, SERIES_COLOURS[0]), "width": 1},
            f"{plain(loop.joint)} iteration %{{x}}: %{{y:.3g}}<extra></extra>",
            marker={"size": 5, "color": colours.get(loop.joint, SERIES_COLOURS[0])},
            **legend(loop.joint or name, shown=first and bool(loop.joint)),
        )
        for loop in loops
    ]
    few = max(len(loop.values) for loop in loops) <= FEW
    return Panel(
        name,
        f"<b>{plain(name)}</b>",
        traces,
        x={**titled("iteration"), "zeroline": False, **({"dtick": 1} if few else {})},
        y={**(LOG_AXIS if changes else {}), **titled(unit or ("relative" if not loops[0].joint else ""))},
        height=PANEL,
    )
