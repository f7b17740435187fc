"""Friction of each joint: coefficients, and the curve against the data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.units import joint_unit
from ident.friction.table import TERMS, Operands, Term
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.report.figures.figures import MEASURED, PREDICTED, Figure, bold, titled
from ident.report.figures.panels import SMALL_PANEL, Panel, in_rows, panel_figure
from ident.report.figures.traces import curve_trace, points_trace, some_of
from ident.report.section import ReportData, ReportSection
from ident.result.friction import JointFrictionResult
from ident.result.schema import Result
from ident.views.number_text import whole
from ident.views.result_tables import friction_step_table, joint_friction_table

DRAWN = tuple(term for term in TERMS if not term.needs)
"""Terms that the velocity alone decides, which a curve over it shows."""

PANEL = 190
SCATTER_POINTS = 1200
PAGE_SCATTER_POINTS = 4_200
SMALL_POINTS = 150
"""Points of a joint in the figure at a glance."""

CURVE_POINTS = 60
"""Per direction of motion."""


def section(data: ReportData) -> ReportSection:
    """Coefficients with their intervals, and a curve per joint."""
    context = {
        "friction": joint_friction_table(data.result).in_order(_order(data)),
        "steps": friction_step_table(data.result),
        "figure": _figure(data),
        "with_weight": [
            parameter
            for parameter in data.result.base_parameters
            if parameter.kind == "offset" and parameter.expression != parameter.name
        ],
    }
    return ReportSection("Friction", "friction", "friction.html.j2", context)


def _order(data: ReportData) -> list[int]:
    return [joint for joint in data.worst_first if joint < len(data.result.friction)]


def _figure(data: ReportData) -> Figure | None:
    joints = _drawn_joints(data)
    if not joints:
        return None
    points = min(SCATTER_POINTS, PAGE_SCATTER_POINTS // len(joints))
    panels = [_panel(data, joint, points) for joint in joints]
    samples = max(sum(int(series.counted[joint].sum()) for series in data.fit) for joint in joints)
    sampled = f" (a random {whole(points)} of up to {whole(samples)} samples per joint)" if samples > points else ""
    caption = (
        "Points: measured torque minus everything that the model predicts except friction and offset, that is, the "
        f"residual plus the curve{sampled}. Line: viscous and Coulomb friction and offset as identified, with the "
        "power law and the Stribeck term where the model has them; terms of load and temperature are not in it. Band: "
        "95 % interval of the line from the parameters' covariance. Where points bend away from the line, a friction "
        "term is missing."
    )
    return panel_figure("friction-plot", in_rows(panels), caption)


def small_friction_figure(anchor: str, data: ReportData) -> Figure | None:
    """The curves at a glance: lower panels with fewer points."""
    joints = _drawn_joints(data)
    if not joints:
        return None
    panels = []
    for joint in joints:
        panel = _panel(data, joint, SMALL_POINTS)
        heading = f"{panel.heading} [{panel.y['title']['text']}]"  # in place of a title of the axis
        panels.append(replace(panel, heading=heading, y={}, height=SMALL_PANEL))
    return panel_figure(anchor, in_rows(panels), "")


def _drawn_joints(data: ReportData) -> list[int]:
    """Joints with friction to draw and samples to draw it with."""
    if not any(series.counted.any() for series in data.fit):
        return []
    friction = data.result.friction
    return [j for j in _order(data) if any(friction[j].coefficient(term.kind) is not None for term in DRAWN)]


def _panel(data: ReportData, joint: int, points: int) -> Panel:
    result = data.result
    name = result.joints[joint]
    velocity = np.concatenate([series.velocity[joint, series.counted[joint]] for series in data.fit])
    residual = np.concatenate([series.residual[joint, series.counted[joint]] for series in data.fit])
    drawn = some_of(np.flatnonzero(np.isfinite(residual)), points)
    velocity, residual = velocity[drawn], residual[drawn]
    curve = _curve_velocity(velocity)
    coefficients = _coefficients(result.friction[joint])
    smoothing, friction = result.model_options.smoothing, result.friction[joint]
    torque = coefficients @ _columns(curve, smoothing, friction)
    data_torque = residual + coefficients @ _columns(velocity, smoothing, friction)
    torque_unit, speed = (joint_unit(unit, sliding=friction.sliding) for unit in ("N·m", "rad/s"))
    hover = f"%{{x:.3g}} {speed}<br>%{{y:.3g}} {torque_unit}<extra></extra>"
    traces: list[dict[str, Any]] = []
    covariance = _covariance(result, name)
    if covariance is not None:
        columns = _columns(curve, smoothing, friction)
        half = WITHIN_95_PERCENT * np.sqrt(np.einsum("ik,ij,jk->k", columns, covariance, columns))
        traces += _band(curve, torque, half)
    traces += [
        points_trace(velocity, data_torque, {"size": 3, "color": MEASURED, "opacity": 0.45}, hover, name="data"),
        curve_trace(curve, torque, {"color": PREDICTED, "width": 2}, hover, name="model"),
    ]
    first = joint == _order(data)[0]
    shown = [{"legendgroup": trace["name"], "showlegend": first, **trace} for trace in traces]
    return Panel(name, bold(name, 36), shown, x=titled(f"velocity [{speed}]"), y=titled(torque_unit), height=PANEL)


def _band(curve: FloatArray, torque: FloatArray, half: FloatArray) -> list[dict[str, Any]]:
    """A closed outline per direction of motion: nan in the curve separates them."""
    bands: list[dict[str, Any]] = []
    for side in (curve < 0, curve > 0):
        x = curve[side]
        outline = np.concatenate([(torque + half)[side], (torque - half)[side][::-1]])
        band = curve_trace(
            np.concatenate([x, x[::-1]]),
            outline,
            {"width": 0},
            name="95 % interval",
            fill="toself",
            fillcolor="rgba(213,94,0,0.28)",
        )
        bands.append(band | {"showlegend": False} if bands else band)
    return bands


def _curve_velocity(velocity: FloatArray) -> FloatArray:
    """Velocities [rad/s] of the curve over the data's range, nan at the step at 0."""
    low, high = min(float(velocity.min(initial=0.0)), -1e-6), max(float(velocity.max(initial=0.0)), 1e-6)
    # Closer together near 0, where a smoothed sign turns.
    shape = np.linspace(0.0, 1.0, CURVE_POINTS + 1)[1:] ** 2
    return np.concatenate([low * shape[::-1], [np.nan], high * shape])


def _columns(velocity: FloatArray, smoothing: float, friction: JointFrictionResult) -> FloatArray:
    """Regressor (k, N) of the drawn terms."""
    direction = np.tanh(velocity / smoothing) if smoothing > 0 else np.sign(velocity)
    signals = [term.signal(Operands(velocity, direction, _shape(friction, term))) for term in DRAWN]
    return np.array([np.broadcast_to(signal, velocity.shape) for signal in signals])


def _shape(friction: JointFrictionResult, term: Term) -> float:
    return 1.0 if term.shape is None else friction.shape_value(term.shape.name) or 1.0


def _coefficients(friction: JointFrictionResult) -> FloatArray:
    """(k,) of the joint; 0 where the model has no such column."""
    return np.array([friction.coefficient(term.kind) or 0.0 for term in DRAWN])


def _covariance(result: Result, joint: str) -> FloatArray | None:
    """Covariance (k, k) of a joint's coefficients, 0 for those that the model lacks; None where it is not stored."""
    if result.estimate is None:
        return None
    names: Sequence[str | None] = [
        next((p.name for p in result.base_parameters if p.joint == joint and p.kind == term.kind), None)
        for term in DRAWN
    ]
    places = [result.estimate.parameters.index(name) if name in result.estimate.parameters else None for name in names]
    covariance = np.zeros((len(DRAWN), len(DRAWN)))
    for i, row in enumerate(places):
        for j, column in enumerate(places):
            if row is not None and column is not None:
                value = result.estimate.covariance[row][column]
                if value is None:
                    return None
                covariance[i, j] = value
    return covariance
