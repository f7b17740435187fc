"""The identified parameters with their error bars."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.report.figures import (
    BOTTOM,
    KIND_STYLES,
    REFERENCE,
    RESIDUAL,
    TOP,
    Figure,
    base_layout,
    kind_markers,
    note,
    vertical_line,
)
from ident.report.number_text import number, setting
from ident.report.section import ReportData, ReportSection
from ident.result.schema import BaseParameterResult, Result

ROW = 15


def section(data: ReportData) -> ReportSection:
    """Base parameters with their error bars, friction of each joint, standard parameters where there are any."""
    result = data.result
    context = {
        "parameters": result.base_parameters,
        "kinds": {kind: words for kind, (words, _, _) in KIND_STYLES.items()},
        "figure": _figure(result),
        "friction": result.friction,
        "threshold": _threshold(result),
        "correction": result.residuals.correction,
        "essential": result.essential,
        "standard": _standard(result.standard_parameters or []),
    }
    return ReportSection("Parameters", "parameters", "parameters.html.j2", context)


def _threshold(result: Result) -> float | None:
    """Relative standard deviation [%] below which a parameter is significant, as the run's options say."""
    value = result.options.get("significant_rsd")
    return float(value) if isinstance(value, int | float) and value > 0 else None


def _ratio(parameter: BaseParameterResult) -> float | None:
    """|value| / σ; None where either is missing."""
    if parameter.value is None or not parameter.std or parameter.value == 0:
        return None
    return abs(parameter.value) / parameter.std


def _figure(result: Result) -> Figure | None:
    shown = [(parameter, ratio) for parameter in result.base_parameters if (ratio := _ratio(parameter)) is not None]
    if not shown:
        return None
    data, names = kind_markers(shown, "%{y}: |value| = %{x:.3g} σ<extra></extra>")
    lines = [(WITHIN_95_PERCENT, "95 %", REFERENCE)]
    threshold = _threshold(result)
    if threshold is not None:
        lines.append((100.0 / threshold, "significant", RESIDUAL))
    reach = [*(ratio for _, ratio in shown), *(x for x, _, _ in lines)]
    height = TOP + BOTTOM + ROW * len(shown)
    layout = base_layout(
        height,
        xaxis={
            "title": {"text": "|value| / σ"},
            "type": "log",
            "range": [math.log10(min(reach)) - 0.3, math.log10(max(reach)) + 0.3],
            "dtick": 1,
            "exponentformat": "power",
        },
        yaxis=names,
        shapes=[vertical_line(x, color=colour, width=1.5, dash="dash") for x, _, colour in lines],
        annotations=[_line_label(x, text, lines) for x, text, _ in lines],
    )
    significance = "" if threshold is None else f", and the threshold of significance (RSD {number(threshold, 3)} %)"
    caption = (
        f"Distance of each value from 0 in standard deviations, on a logarithmic scale. Dashed: {WITHIN_95_PERCENT} σ, "
        f"below which the 95 % interval contains 0{significance}."
    )
    return Figure("parameters-plot", height, data, layout, caption)


def _line_label(x: float, text: str, lines: Sequence[tuple[float, str, str]]) -> dict[str, Any]:
    """Above its line, to the side that is free."""
    left = x == min(position for position, _, _ in lines) and len(lines) > 1
    return note(text, math.log10(x), 1.0, xref="x", xanchor="right" if left else "left", font={"size": 11})


def _standard(entries: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Columns and cells of a table whose keys the export decides."""
    columns = list(dict.fromkeys(key for entry in entries for key in entry))
    return {"columns": columns, "rows": [[_cell(entry.get(key)) for key in columns] for entry in entries]}


def _cell(value: Any) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(_cell(element) for element in value)
    return setting(value) if value is None or isinstance(value, float | int | str | bool) else str(value)
