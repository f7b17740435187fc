"""How an iterative estimator converged, and which equations it rejected (AUBO Figs. 10 and 11)."""

from __future__ import annotations

from typing import Any

from ident.report.figures import ACCENT, LOG_AXIS, Figure, plain
from ident.report.panels import Panel, panel_figure
from ident.report.section import ReportData, ReportSection
from ident.result.schema import Convergence

PANEL = 180


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
        "joints": [one.joint for one in convergence.equations],
        "correlation": convergence.joint_correlation,
    }
    return ReportSection("Convergence", "convergence", "convergence.html.j2", context)


def _figure(convergence: Convergence) -> Figure | None:
    panels = [_panel(loop.name, loop.unit, loop.values) for loop in convergence.loops if loop.values]
    if not panels:
        return None
    rows = [panels[start : start + 2] for start in range(0, len(panels), 2)]
    caption = "Each loop over its iterations, innermost first; a loop has converged where its values no longer change."
    return panel_figure("convergence-plot", rows, caption, showlegend=False)


def _panel(name: str, unit: str, values: list[float | None]) -> Panel:
    known = [value for value in values if value is not None]
    changes = all(value > 0 for value in known) and max(known, default=1.0) > 30.0 * min(known, default=1.0)
    trace: dict[str, Any] = {
        "type": "scatter",
        "mode": "lines+markers",
        "name": name,
        "x": list(range(1, len(values) + 1)),
        "y": values,
        "line": {"color": ACCENT, "width": 1},
        "marker": {"size": 5, "color": ACCENT},
        "hovertemplate": "iteration %{x}: %{y:.3g}<extra></extra>",
    }
    return Panel(
        name,
        f"<b>{plain(name)}</b>",
        [trace],
        x={"title": {"text": "iteration"}, "zeroline": False},
        y={**(LOG_AXIS if changes else {}), "title": {"text": unit or "relative"}},
        height=PANEL,
    )
