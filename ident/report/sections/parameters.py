"""The identified parameters with their error bars."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.report.figures import KIND_STYLES, RESIDUAL, Figure, plain
from ident.report.panels import Panel, panel_figure
from ident.report.reference_values import ReferenceValues, reference_values
from ident.report.section import ReportData, ReportSection
from ident.result.schema import BaseParameterResult, Result

ROW = 15
"""Height of a parameter's line [px]."""

REFERENCE_MARKER = "#7C828A"


def section(data: ReportData) -> ReportSection:
    """Base parameters with their error bars."""
    result = data.result
    reference = reference_values(data)
    context = {
        "parameters": result.base_parameters,
        "kinds": {kind: words for kind, (words, _, _) in KIND_STYLES.items()},
        "figure": _figure(result, reference),
        "reference": reference,
        "reference_words": _reference_words(reference) if reference is not None else "",
        "threshold": _threshold(result),
        "correction": result.residuals.correction,
        "essential": result.essential,
    }
    return ReportSection("Parameters", "parameters", "parameters.html.j2", context)


def _threshold(result: Result) -> float | None:
    """Relative standard deviation [%] below which a parameter is significant, as the run's options say."""
    value = result.options.get("significant_rsd")
    return float(value) if isinstance(value, int | float) and value > 0 else None


def _figure(result: Result, reference: ReferenceValues | None) -> Figure | None:
    """Values with their intervals: a panel per kind and unit, so that values of one panel can be compared."""
    groups: dict[tuple[str, str], list[BaseParameterResult]] = {}
    for parameter in result.base_parameters:
        if parameter.value is not None:
            groups.setdefault((parameter.kind, parameter.unit), []).append(parameter)
    if not groups:
        return None
    known = {} if reference is None else reference.values
    first = next((group for group, entries in groups.items() if any(p.name in known for p in entries)), None)
    rows = [
        [_panel(kind, unit, entries, known, reference.label if reference and (kind, unit) == first else "")]
        for (kind, unit), entries in groups.items()
    ]
    compared = f" Open diamond: {_reference_words(reference)}." if known and reference is not None else ""
    caption = (
        "Values of the full model with their 95 % intervals. An interval that contains 0 belongs to a parameter that "
        f"this recording does not show to exist.{compared}"
    )
    return panel_figure("parameters-plot", rows, caption)


def _reference_words(reference: ReferenceValues) -> str:
    return "the true value" if reference.label == "True value" else "what the robot file says of the links"


def _panel(
    kind: str, unit: str, entries: Sequence[BaseParameterResult], known: Mapping[str, float], legend: str
) -> Panel:
    words, colour, symbol = KIND_STYLES[kind]
    names = [plain(parameter.name) for parameter in entries]
    half = [
        WITHIN_95_PERCENT * parameter.std if parameter.std is not None and math.isfinite(parameter.std) else 0.0
        for parameter in entries
    ]
    traces: list[dict[str, Any]] = [
        {
            "type": "scatter",
            "mode": "markers",
            "name": "estimate ± 95 %",
            "showlegend": bool(legend),
            "x": [parameter.value for parameter in entries],
            "y": names,
            "marker": {"color": colour, "symbol": symbol, "size": 6},
            "error_x": {"type": "data", "array": half, "thickness": 1.5, "width": 3, "color": colour},
            "hovertemplate": f"%{{y}}: %{{x:.4g}} {unit}<extra></extra>",
        }
    ]
    having = [(name, known[p.name]) for name, p in zip(names, entries, strict=True) if p.name in known]
    if having:
        traces.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": legend.lower() or "reference",
                "showlegend": bool(legend),
                "x": [value for _, value in having],
                "y": [name for name, _ in having],
                "marker": {"color": REFERENCE_MARKER, "symbol": "diamond-open", "size": 9, "line": {"width": 1.5}},
                "hovertemplate": f"{legend.lower() or 'reference'} of %{{y}}: %{{x:.4g}} {unit}<extra></extra>",
            }
        )
    return Panel(
        f"{words} [{unit}]",
        f"<b>{words}</b> [{unit}]",
        traces,
        y={
            "type": "category",
            "categoryorder": "array",
            "categoryarray": names,
            "range": [len(names) - 0.4, -0.6],
            "dtick": 1,
            "tickfont": {"size": 10},
            "automargin": True,
        },
        vertical=[(0.0, {"color": RESIDUAL, "width": 1})],
        height=ROW * len(names) + 16,
    )
