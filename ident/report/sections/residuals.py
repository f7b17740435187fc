"""Residuals of the fit, and the assumptions of least squares (AUBO .3.2)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ident.report.figures import (
    ACCENT,
    BOTTOM,
    REFERENCE,
    TOP,
    Figure,
    axis_name,
    axis_ref,
    base_layout,
    note,
    plain,
    row_domains,
    shortened,
)
from ident.report.number_text import number, whole
from ident.report.residual_statistics import HISTOGRAM_EDGES, JointResidual, joint_residual
from ident.report.section import ReportData, ReportSection
from ident.report.traces import packed

PANEL, GAP = 140, 46
COLUMNS = ((0.0, 0.29), (0.36, 0.64), (0.71, 1.0))
SCATTER_POINTS = 1500
PAGE_SCATTER_POINTS = 15_000
FEWEST_LAGS, MOST_LAGS = 60, 400


def section(data: ReportData) -> ReportSection:
    """Residual against velocity, autocorrelation and histogram of each joint."""
    result = data.result
    lags = int(np.clip(1.3 * result.residuals.block_length, FEWEST_LAGS, MOST_LAGS)) + 1
    residuals = [joint_residual(data.fit, joint, lags) for joint in range(len(result.joints))]
    shown = any(len(joint.residual) for joint in residuals)
    context = {
        "figure": _figure(result.joints, residuals, _step(data)) if shown else None,
        "rows": [
            {"joint": name, "residual": joint, "lag_one": next(iter(joint.autocorrelation[1:2]), None)}
            for name, joint in zip(result.joints, residuals, strict=True)
        ],
        "residuals": result.residuals,
        "block_seconds": result.residuals.block_length * _step(data),
    }
    return ReportSection("Residuals", "residuals", "residuals.html.j2", context)


def _step(data: ReportData) -> float:
    """Median sampling interval of the filtered torques [s]."""
    steps = [np.diff(series.time) for series in data.fit if len(series.time) > 1]
    return float(np.median(np.concatenate(steps))) if steps else 1.0


def _figure(joints: Sequence[str], residuals: Sequence[JointResidual], step: float) -> Figure:
    rows = len(joints)
    height = TOP + BOTTOM + PANEL * rows + GAP * (rows - 1)
    domains = row_domains(rows, height, GAP)
    data: list[dict[str, Any]] = []
    axes: dict[str, Any] = {}
    notes = []
    points = min(SCATTER_POINTS, PAGE_SCATTER_POINTS // rows)
    for row, (name, joint, domain) in enumerate(zip(joints, residuals, domains, strict=True)):
        titles = ("velocity [rad/s]", "lag [s]", "residual / σ") if row == rows - 1 else ("", "", "")
        sides = ("N·m", "", "")
        for column, (across, title, side) in enumerate(zip(COLUMNS, titles, sides, strict=True)):
            k = 3 * row + column + 1
            axes[axis_name("x", k)] = _axis(across, axis_ref("y", k), title)
            axes[axis_name("y", k)] = _axis(domain, axis_ref("x", k), side)
        headings = (f"<b>{plain(shortened(name, 26))}</b>: residual", "autocorrelation", "density")
        notes += [note(text, across[0], domain[1]) for text, across in zip(headings, COLUMNS, strict=True)]
        data += _scatter(joint, 3 * row + 1, points)
        data += _correlogram(joint, 3 * row + 2, step)
        data += _histogram(joint, 3 * row + 3)
    largest = max(len(joint.residual) for joint in residuals)
    sampled = f" (a random {whole(points)} of {whole(largest)} samples)" if largest > points else ""
    caption = (
        f"Left: residual against the joint's velocity{sampled}. Middle: autocorrelation; the dashed band, ±1.96/√N, "
        f"contains 95 % of the values if the residuals are white; the first lag is one filtered sample, "
        f"{number(1e3 * step, 3)} ms. Right: histogram of residual / σ and the normal distribution."
    )
    layout = base_layout(height, annotations=notes, showlegend=False, **axes)
    return Figure("residuals-plot", height, data, layout, caption)


def _scatter(joint: JointResidual, k: int, points: int) -> list[dict[str, Any]]:
    kept = np.arange(len(joint.residual))
    if len(kept) > points:
        # Random, not every n-th: a stride could fall in step with a periodic motion.
        kept = np.sort(np.random.default_rng(0).choice(kept, points, replace=False))
    return [
        {
            "type": "scatter",
            "mode": "markers",
            "x": packed(joint.velocity[kept]),
            "y": packed(joint.residual[kept]),
            "marker": {"size": 3, "color": ACCENT, "opacity": 0.45},
            "hovertemplate": "%{x:.3g} rad/s<br>%{y:.3g} N·m<extra></extra>",
            **_axes(k),
        }
    ]


def _correlogram(joint: JointResidual, k: int, step: float) -> list[dict[str, Any]]:
    lag = step * np.arange(len(joint.autocorrelation))
    if not len(lag):
        return []
    band = [
        {
            "type": "scatter",
            "mode": "lines",
            "x": [float(lag[0]), float(lag[-1])],
            "y": [sign * joint.band, sign * joint.band],
            "line": {"color": REFERENCE, "width": 1, "dash": "dash"},
            "hoverinfo": "skip",
            **_axes(k),
        }
        for sign in (1.0, -1.0)
    ]
    line = {
        "type": "scatter",
        "mode": "lines",
        "fill": "tozeroy",
        "x": packed(lag),
        "y": packed(joint.autocorrelation),
        "line": {"color": ACCENT, "width": 1.2},
        "hovertemplate": "lag %{x:.3g} s<br>%{y:.3f}<extra></extra>",
        **_axes(k),
    }
    return [line, *band]


def _histogram(joint: JointResidual, k: int) -> list[dict[str, Any]]:
    centres = 0.5 * (HISTOGRAM_EDGES[1:] + HISTOGRAM_EDGES[:-1])
    grid = np.linspace(-5.0, 5.0, 101)
    return [
        {
            "type": "bar",
            "x": packed(centres),
            "y": packed(joint.density),
            "width": float(HISTOGRAM_EDGES[1] - HISTOGRAM_EDGES[0]),
            "marker": {"color": ACCENT, "opacity": 0.55},
            "hovertemplate": "%{x:.1f} σ<br>%{y:.3f}<extra></extra>",
            **_axes(k),
        },
        {
            "type": "scatter",
            "mode": "lines",
            "x": packed(grid),
            "y": packed(np.exp(-0.5 * grid**2) / np.sqrt(2.0 * np.pi)),
            "line": {"color": REFERENCE, "width": 1.5},
            "hoverinfo": "skip",
            **_axes(k),
        },
    ]


def _axis(domain: tuple[float, float], anchor: str, title: str) -> dict[str, Any]:
    return {"domain": list(domain), "anchor": anchor, "title": {"text": title}, "nticks": 5}


def _axes(k: int) -> dict[str, str]:
    return {"xaxis": axis_ref("x", k), "yaxis": axis_ref("y", k)}
