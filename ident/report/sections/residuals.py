"""Torques of the fit and of held-out data, their residuals, and the assumptions of least squares (AUBO .3.2)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.units import joint_unit
from ident.assessment.residual_tests import LARGEST_AUTOCORRELATION, LARGEST_CURVATURE, LARGEST_SHAPE, LARGEST_SPREAD
from ident.regression.comparison import TorqueSeries
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT, p_text
from ident.report.figures.figures import ACCENT, REFERENCE, Figure, bold, titled
from ident.report.figures.panels import Panel, panel_figure
from ident.report.figures.torque_figure import torque_figure
from ident.report.figures.traces import curve_trace, packed, points_trace, some_of
from ident.report.section import ReportData, ReportSection
from ident.views.number_text import number, whole

HISTOGRAM_EDGES = np.linspace(-5.0, 5.0, 51)
"""Edges in standard deviations; what lies beyond counts for the first and the last bin."""

PROBABILITIES = np.concatenate([[0.0005, 0.001, 0.002], np.linspace(0.005, 0.995, 100), [0.998, 0.999, 0.9995]])
"""Probabilities of the quantiles that are compared with those of a normal distribution."""

MEAN_ROUNDING = 1e-9
"""A mean of fewer standard deviations is what rounding left of 0: an offset column takes it out exactly."""

SCATTER_POINTS = 1500
PAGE_SCATTER_POINTS = 3_600
FEWEST_LAGS, MOST_LAGS = 60, 400

NOT_CONVERGED = ("weights-not-settled", "search-gap")
"""Checks of an estimator that did not converge."""


def validation_section(data: ReportData) -> ReportSection:
    """Measured against predicted torque of the held-out data."""
    result = data.result
    source = result.validation_source or "held-out data"
    errors = result.delivered.validation_all_samples
    intro = f"Held out: {source}. These are the errors to expect, samples at rest included."
    if errors is not None and errors.held_out is False:
        intro = f"NOT held out: {source}. Samples of these data were used in the identification."
    context = {
        "intro": intro if data.validation else "",
        "figure": torque_figure("torques-validation-plot", result, data.worst_first, data.validation, errors),
        "empty": "No data were held out, so this page cannot say how far to trust the model. Record a second motion "
        "and give it with --validate.",
    }
    return ReportSection("Torques: validation", "torques-validation", "torques.html.j2", context)


def fit_section(data: ReportData) -> ReportSection:
    """Measured against predicted torque of the identification data."""
    context = {
        "intro": "The data that the parameters were fitted to: a small error here is necessary, not sufficient.",
        "figure": torque_figure("torques-fit-plot", data.result, data.worst_first, data.fit, data.result.fit),
        "empty": "No torques of the identification data are available.",
    }
    return ReportSection("Torques: fit", "torques-fit", "torques.html.j2", context)


@dataclass(frozen=True)
class JointResidual:
    """Residuals of one joint, over the samples used."""

    # velocity, predicted, residual: (N,) [rad/s or m/s], [N·m], [N·m], segments one after the other
    velocity: FloatArray
    predicted: FloatArray
    residual: FloatArray
    # mean, std: [N·m]; nan without samples
    mean: float
    std: float
    autocorrelation: FloatArray  # (L,) at lags 0 … L − 1
    band: float  # half width of the 95 % band of white residuals
    outside: float  # share of the autocorrelations from lag 1 on outside the band
    density: FloatArray  # (50,) histogram of residual / std, as a density
    quantiles: FloatArray  # (Q,) of residual / std, at the probabilities `PROBABILITIES`; empty without samples
    beyond_three: float  # share of the samples further than 3 std from the mean (0.27 % of a normal distribution)
    excess_kurtosis: float  # 0 for a normal distribution


def joint_residual(series: Sequence[TorqueSeries], joint: int, lags: int) -> JointResidual:
    """Describe the residual of joint number `joint`; `lags` autocorrelations, never across a gap."""
    used = [segment.counted[joint] for segment in series]
    velocity = _joined([segment.velocity[joint, mask] for segment, mask in zip(series, used, strict=True)])
    segments = [segment.measured[joint] - segment.predicted[joint] for segment in series]
    residual = _joined([segment[mask] for segment, mask in zip(segments, used, strict=True)])
    samples = len(residual)
    mean = float(residual.mean()) if samples else float("nan")
    std = float(residual.std()) if samples else float("nan")
    if abs(mean) < MEAN_ROUNDING * std:
        mean = 0.0
    centred = [np.where(mask, segment - mean, 0.0) for segment, mask in zip(segments, used, strict=True)]
    correlation = _autocorrelation(centred, min(lags, max(1, samples - 1))) if samples and std > 0 else np.empty(0)
    band = WITHIN_95_PERCENT / np.sqrt(samples) if samples else float("nan")
    scaled = (residual - mean) / std if samples and std > 0 else np.empty(0)
    counts, _ = np.histogram(np.clip(scaled, -4.999, 4.999), HISTOGRAM_EDGES)
    nothing = float("nan")
    return JointResidual(
        velocity=velocity,
        predicted=_joined([segment.predicted[joint, mask] for segment, mask in zip(series, used, strict=True)]),
        residual=residual,
        mean=mean,
        std=std,
        autocorrelation=correlation,
        band=band,
        outside=float(np.mean(np.abs(correlation[1:]) > band)) if len(correlation) > 1 else nothing,
        density=counts / (max(1, len(scaled)) * np.diff(HISTOGRAM_EDGES)),
        quantiles=np.quantile(scaled, PROBABILITIES) if len(scaled) else np.empty(0),
        beyond_three=float(np.mean(np.abs(scaled) > 3.0)) if len(scaled) else nothing,
        excess_kurtosis=float(np.mean(scaled**4)) - 3.0 if len(scaled) else nothing,
    )


def _joined(segments: Sequence[FloatArray]) -> FloatArray:
    return np.concatenate(segments) if segments else np.empty(0)


def _autocorrelation(centred: Sequence[FloatArray], lags: int) -> FloatArray:
    """Sums of products at lags 0 … lags − 1 within each segment, added up, relative to lag 0."""
    total = np.zeros(lags)
    for segment in centred:
        size = 1 << (2 * max(len(segment), lags) - 1).bit_length()
        spectrum = np.fft.rfft(segment, size)
        total += np.fft.irfft(np.abs(spectrum) ** 2, size)[:lags]
    return np.asarray(total / total[0])


def section(data: ReportData) -> ReportSection:
    """Residual against torque and velocity, autocorrelation, histogram and quantiles of each joint, with tests."""
    result = data.result
    lags = int(np.clip(1.3 * result.residuals.block_length, FEWEST_LAGS, MOST_LAGS)) + 1
    residuals = {joint: joint_residual(data.fit, joint, lags) for joint in data.worst_first}
    shown = any(len(joint.residual) for joint in residuals.values())
    order = [result.joints[joint] for joint in data.worst_first]
    context = {
        "scatter": _scatter_figure(result.joints, result.sliding, residuals) if shown else None,
        "figure": _figure(result.joints, residuals, _step(data)) if shown else None,
        "rows": [
            {
                "joint": result.joints[joint],
                "residual": residual,
                "lag_one": next(iter(residual.autocorrelation[1:2]), None),
            }
            for joint, residual in residuals.items()
        ],
        "residuals": result.residuals,
        "assumptions": sorted(result.residuals.assumptions, key=lambda assumption: order.index(assumption.joint)),
        "p_text": lambda value: "–" if value is None else p_text(value),
        "limits": {
            "curvature": LARGEST_CURVATURE,
            "autocorrelation": LARGEST_AUTOCORRELATION,
            "spread": LARGEST_SPREAD,
            "shape": LARGEST_SHAPE,
        },
        "settled": not any(check.name in NOT_CONVERGED for check in result.verdict.checks),
        "block_seconds": result.residuals.block_length * _step(data),
    }
    return ReportSection("Residuals", "residuals", "residuals.html.j2", context)


def _step(data: ReportData) -> float:
    """Median sampling interval of the filtered torques [s]."""
    steps = [np.diff(series.time) for series in data.fit if len(series.time) > 1]
    return float(np.median(np.concatenate(steps))) if steps else 1.0


def _scatter_figure(joints: Sequence[str], sliding: Sequence[bool], residuals: Mapping[int, JointResidual]) -> Figure:
    """Residual against predicted torque and velocity."""
    points = min(SCATTER_POINTS, PAGE_SCATTER_POINTS // len(joints))
    largest = max(len(joint.residual) for joint in residuals.values())
    sampled = f" (a random {whole(points)} of {whole(largest)} samples)" if largest > points else ""
    caption = f"Residual against predicted torque and against the joint's velocity{sampled}."
    rows = []
    for index, joint in residuals.items():
        name = joints[index]
        heading = f"{bold(name)}: residual"
        torque, speed = (joint_unit(unit, sliding=sliding[index]) for unit in ("N·m", "rad/s"))
        rows.append(
            [
                Panel(
                    name,
                    heading,
                    _scatter(joint, values, points, (unit, torque)),
                    x=titled(f"{quantity} [{unit}]"),
                    y=titled(torque),
                )
                for quantity, values, unit in (
                    ("predicted torque", joint.predicted, torque),
                    ("velocity", joint.velocity, speed),
                )
            ]
        )
    return panel_figure("residual-scatter-plot", rows, caption, showlegend=False)


def _figure(joints: Sequence[str], residuals: Mapping[int, JointResidual], step: float) -> Figure:
    rows = [_row(joints[joint], residual, step) for joint, residual in residuals.items()]
    caption = (
        f"First: autocorrelation; the dashed band, ±1.96/√N, contains 95 % of the values if the residuals are white, "
        f"the dotted one is ±{LARGEST_AUTOCORRELATION:g}; the first lag is one filtered sample, "
        f"{number(1e3 * step, 3)} ms. Second: histogram of residual / σ and the normal distribution. Third: quantiles "
        "of residual / σ against those of the normal distribution, on the line if the residuals are normal."
    )
    return panel_figure("residuals-plot", rows, caption, showlegend=False)


def _row(name: str, joint: JointResidual, step: float) -> list[Panel]:
    joint_name = bold(name)
    return [
        Panel(name, f"{joint_name}: autocorrelation", _correlogram(joint, step), x=titled("lag [s]")),
        Panel(name, "density", _histogram(joint), f"{joint_name}: density", x=titled("residual / σ")),
        Panel(name, "quantiles", _quantiles(joint), f"{joint_name}: quantiles", x=titled("of a normal distribution")),
    ]


def _scatter(joint: JointResidual, values: FloatArray, points: int, units: tuple[str, str]) -> list[dict[str, Any]]:
    kept = some_of(np.arange(len(joint.residual)), points)
    return [
        points_trace(
            values[kept],
            joint.residual[kept],
            {"size": 3, "color": ACCENT, "opacity": 0.45},
            f"%{{x:.3g}} {units[0]}<br>%{{y:.3g}} {units[1]}<extra></extra>",
            name="residual",
        )
    ]


def _correlogram(joint: JointResidual, step: float) -> list[dict[str, Any]]:
    lag = step * np.arange(len(joint.autocorrelation))
    if not len(lag):
        return []
    band = [
        curve_trace([float(lag[0]), float(lag[-1])], [height, height], {"color": REFERENCE, "width": 1, "dash": dash})
        for bound, dash in ((joint.band, "dash"), (LARGEST_AUTOCORRELATION, "dot"))
        for height in (bound, -bound)
    ]
    line = curve_trace(
        lag,
        joint.autocorrelation,
        {"color": ACCENT, "width": 1.2},
        "lag %{x:.3g} s<br>%{y:.3f}<extra></extra>",
        name="autocorrelation",
        fill="tozeroy",
    )
    return [line, *band]


def _histogram(joint: JointResidual) -> list[dict[str, Any]]:
    centres = 0.5 * (HISTOGRAM_EDGES[1:] + HISTOGRAM_EDGES[:-1])
    grid = np.linspace(-5.0, 5.0, 101)
    return [
        {
            "type": "bar",
            "name": "density",
            "x": packed(centres),
            "y": packed(joint.density),
            "width": float(HISTOGRAM_EDGES[1] - HISTOGRAM_EDGES[0]),
            "marker": {"color": ACCENT, "opacity": 0.55},
            "hovertemplate": "%{x:.1f} σ<br>%{y:.3f}<extra></extra>",
        },
        curve_trace(grid, np.exp(-0.5 * grid**2) / np.sqrt(2.0 * np.pi), {"color": REFERENCE, "width": 1.5}),
    ]


def _quantiles(joint: JointResidual) -> list[dict[str, Any]]:
    if not len(joint.quantiles):
        return []
    from scipy.special import ndtri

    normal = ndtri(PROBABILITIES)
    return [
        points_trace(
            normal,
            joint.quantiles,
            {"size": 4, "color": ACCENT},
            "normal %{x:.2f}<br>residual / σ %{y:.2f}<extra></extra>",
            name="quantile",
        ),
        curve_trace(
            [float(normal[0]), float(normal[-1])],
            [float(normal[0]), float(normal[-1])],
            {"color": REFERENCE, "width": 1.5},
        ),
    ]
