"""Correlation of the estimated parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from drivers.core.arrays import FloatArray
from ident.report.figures.figures import BOTTOM, TOP, Figure, base_layout, narrow_layout, plain
from ident.report.section import ReportData, ReportSection
from ident.result.estimate import EstimateResult

STRONG = 0.7
"""Absolute correlation from which a pair is listed."""

MOST_PAIRS = 15
HIGHEST, ROW = 640, 22
NARROW_HIGHEST = 330
DIGITS = 4
SCALE = [[0.0, "#0072B2"], [0.5, "#F2F2F2"], [1.0, "#D55E00"]]


def section(data: ReportData) -> ReportSection | None:
    """The matrix, and its strongest pairs; None for a result without covariance."""
    estimate = data.result.estimate
    if estimate is None or len(estimate.parameters) < 2:
        return None
    matrix = _correlation(estimate)
    pairs = _pairs(estimate.parameters, matrix)
    context = {
        "figure": _figure(estimate.parameters, matrix),
        "pairs": pairs[:MOST_PAIRS],
        "strong": len(pairs),
        "threshold": STRONG,
    }
    return ReportSection("Correlation", "correlation", "correlation.html.j2", context)


def _correlation(estimate: EstimateResult) -> FloatArray:
    """(a, a) correlation; nan where a variance is not known."""
    covariance = np.array([[np.nan if value is None else value for value in row] for row in estimate.covariance])
    deviations = np.sqrt(np.diag(covariance))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(covariance / np.outer(deviations, deviations))


def _pairs(names: Sequence[str], matrix: FloatArray) -> list[tuple[str, str, float]]:
    """Pairs with a strong correlation, the strongest first."""
    rows, columns = np.triu_indices(len(names), 1)
    values = matrix[rows, columns]
    strong = np.flatnonzero(np.abs(values) >= STRONG)  # nan is not
    ordered = strong[np.argsort(-np.abs(values[strong]))]
    return [(names[rows[k]], names[columns[k]], float(values[k])) for k in ordered]


def _figure(names: Sequence[str], matrix: FloatArray) -> Figure:
    shown = [plain(name) for name in names]
    trace = {
        "type": "heatmap",
        "x": shown,
        "y": shown,
        "z": [[None if np.isnan(value) else round(value, DIGITS) for value in row] for row in matrix.tolist()],
        "zmin": -1,
        "zmax": 1,
        "colorscale": SCALE,
        "hovertemplate": "%{y}, %{x}: %{z:.3f}<extra></extra>",
        "colorbar": {"thickness": 12, "outlinewidth": 0, "tickvals": [-1, -0.5, 0, 0.5, 1]},
    }
    height = TOP + BOTTOM + min(HIGHEST, ROW * len(names) + 60)
    narrow_height = TOP + BOTTOM + NARROW_HIGHEST
    caption = (
        "Correlation coefficients of the estimates, corrected for autocorrelated residuals. Two parameters with a "
        "coefficient near ±1 are poorly distinguishable by this motion: only a combination of them is well known."
    )
    narrow = {**narrow_layout(narrow_height), **_axes(len(names), NARROW_HIGHEST, 270)}
    layout = base_layout(height, **_axes(len(names), height - TOP - BOTTOM, 900))
    return Figure("correlation-plot", height, [trace], layout, caption, narrow)


def _axes(count: int, height: int, width: int) -> dict[str, Mapping[str, Any]]:
    """Names on both axes, as many as there is room for."""
    common = {"type": "category", "showgrid": False, "zeroline": False, "automargin": True, "tickfont": {"size": 9}}
    return {
        "xaxis": {**common, "tickangle": -90, "dtick": -(-12 * count // width)},
        "yaxis": {**common, "autorange": "reversed", "dtick": -(-12 * count // height)},
    }
