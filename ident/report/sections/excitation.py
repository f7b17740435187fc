"""How well the motion excites the parameters."""

from __future__ import annotations

import math

from ident.report.figures.figures import ACCENT, BOTTOM, LOG_AXIS, TOP, Figure, base_layout
from ident.report.section import ReportData, ReportSection, Tile
from ident.result.schema import Result
from ident.views.number_text import number

PANEL = 260


def section(data: ReportData) -> ReportSection:
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
    height = TOP + BOTTOM + PANEL
    data = [
        {
            "type": "scatter",
            "mode": "lines+markers",
            "x": list(range(1, len(values) + 1)),
            "y": values,
            "line": {"color": ACCENT, "width": 1},
            "marker": {"size": 6, "color": ACCENT},
            "hovertemplate": "no. %{x}: %{y:.3g}<extra></extra>",
        }
    ]
    layout = base_layout(
        height,
        showlegend=False,
        xaxis={"title": {"text": "number"}, "zeroline": False},
        yaxis={**LOG_AXIS, "title": {"text": "singular value"}},
    )
    caption = (
        "Singular values of the column-normalised W; their largest ratio is the condition number. A "
        "sharp drop at the end shows combinations of parameters that this motion makes poorly identifiable."
    )
    return Figure("singular-values-plot", height, data, layout, caption)
