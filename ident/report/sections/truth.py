"""Estimates against the true parameters of a simulated arm."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.report.figures.figures import (
    BOTTOM,
    REFERENCE,
    TOP,
    Figure,
    base_layout,
    kind_markers,
    titled,
    vertical_line,
)
from ident.report.figures.panels import ROW
from ident.report.section import ReportData, ReportSection, Tile
from ident.result.schema import BaseParameterResult
from ident.views.number_text import DASH, number, percent


@dataclass(frozen=True)
class Comparison:
    """One base parameter against its true value; None where there is no estimate, or no truth."""

    parameter: BaseParameterResult
    true: float | None
    error: float | None
    relative_percent: float | None
    ratio: float | None

    @property
    def inside(self) -> bool | None:
        """Return whether the 95 % interval holds the truth."""
        return None if self.ratio is None else abs(self.ratio) <= WITHIN_95_PERCENT


def section(data: ReportData) -> ReportSection | None:
    """True value, estimate and error of every base parameter; None where the truth is not known."""
    if data.truth is None:
        return None
    values = dict(zip(data.truth.names, map(float, data.truth.values), strict=True))
    rows = [_compare(parameter, values.pop(parameter.name, None)) for parameter in data.result.base_parameters]
    context = {"rows": rows, "tiles": _tiles(rows), "figure": _figure(rows), "unmatched": sorted(values)}
    return ReportSection("Truth", "truth", "truth.html.j2", context)


def _compare(parameter: BaseParameterResult, true: float | None) -> Comparison:
    if true is None or parameter.value is None:
        return Comparison(parameter, true, None, None, None)
    error = parameter.value - true
    relative = 100.0 * error / abs(true) if true else None
    return Comparison(parameter, true, error, relative, error / parameter.std if parameter.std else None)


def _tiles(rows: list[Comparison]) -> list[Tile]:
    ratios = [row.ratio for row in rows if row.ratio is not None]
    if not ratios:
        return [Tile("Inside the 95 % interval", DASH, "no parameter has both an estimate and a truth")]
    inside = sum(abs(ratio) <= WITHIN_95_PERCENT for ratio in ratios)
    rms = math.sqrt(sum(ratio**2 for ratio in ratios) / len(ratios))
    return [
        Tile(
            "Inside the 95 % interval", f"{inside} of {len(ratios)}", f"{percent(inside / len(ratios))}; 95 % expected"
        ),
        Tile("RMS of error / σ", number(rms, 3), "1 expected; above, the error bars are too short"),
        Tile("Largest |error| / σ", number(max(map(abs, ratios)), 3)),
    ]


def _figure(rows: list[Comparison]) -> Figure | None:
    shown = [(row.parameter, row.ratio) for row in rows if row.ratio is not None]
    if not shown:
        return None
    interval = {"type": "constant", "value": WITHIN_95_PERCENT, "thickness": 1, "width": 0}
    data, names = kind_markers(shown, "%{y}: error = %{x:.3g} σ<extra></extra>", interval)
    height = TOP + BOTTOM + ROW * len(shown)
    layout = base_layout(
        height,
        xaxis={**titled("(estimate − truth) / σ, with the 95 % interval"), "zeroline": False},
        yaxis=names,
        shapes=[vertical_line(0.0, color=REFERENCE, width=1.5)],
    )
    return Figure("truth-plot", height, data, layout, "An interval that crosses the line at 0 contains the true value.")
