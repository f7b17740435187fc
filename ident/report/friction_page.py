"""Page of friction experiments: friction over speed, temperature and load (AUBO Figs. 1 and 2)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.units import ZERO_CELSIUS, common_unit, joint_unit
from ident.experiments.friction.experiment import FrictionExperiment
from ident.experiments.friction.joint_data import JointExperiment, friction_torque
from ident.model.dynamic_model import DynamicModel
from ident.report.figures.figures import MEASURED, PREDICTED, SERIES_COLOURS, Figure, bold, titled
from ident.report.figures.panels import Panel, in_rows, panel_figure
from ident.report.figures.traces import curve_trace, legend, packed, points_trace, some_of
from ident.report.html_file import rendered
from ident.report.section import Tile
from ident.result.friction_experiment import FrictionExperimentResult
from ident.views.friction_tables import COEFFICIENTS, COVERED, friction_table
from ident.views.number_text import number

POINTS = 1200
"""Per panel."""

CURVE_POINTS = 80
PANEL = 210
HOVER = "%{x:.3g}<br>%{y:.3g}<extra></extra>"
SPEED_SHARES = (0.1, 0.3, 0.6)
"""Speeds of the curves over temperature and load, over the greatest one."""

SPEED_WINDOW = 0.15
"""Points of a speed are within this share of it."""


def friction_page(experiment: FrictionExperiment) -> str:
    """The page: coefficients, curves with the data, terms that were tried."""
    result, joints, model = experiment.result, experiment.joints, experiment.periods.model
    heated = [joint for joint in joints if joint.stored.temperature_range is not None]
    loaded = [joint for joint in joints if joint.stored.load_range.greatest > 0.0]
    table = friction_table(result)
    return rendered(
        "friction_page",
        result=result,
        coefficients=table.pick(*COEFFICIENTS),
        covered=table.pick(*COVERED),
        tiles=_tiles(result),
        speed=_figure("speed-plot", model, joints, _speed_panel, SPEED_CAPTION),
        temperature=_figure("temperature-plot", model, heated, _temperature_panel, TEMPERATURE_CAPTION),
        load=_figure("load-plot", model, loaded, _load_panel, LOAD_CAPTION),
    )


SPEED_CAPTION = (
    "Points: measured torque minus inertia and gravity as identified, coloured by the joint's temperature where it was "
    "recorded. Lines: friction as identified at the lowest and the highest temperature, at the mean load term."
)
TEMPERATURE_CAPTION = (
    "Friction in the direction of motion over temperature at three speeds: points within 15 % of the speed, and the "
    "model there."
)
LOAD_CAPTION = (
    "Friction in the direction of motion over the load torque at three speeds: points within 15 % of the speed, and "
    "the model there at the mean temperature."
)


def _tiles(result: FrictionExperimentResult) -> list[Tile]:
    torque = common_unit("N·m", [joint.sliding for joint in result.joints])
    heat = [joint.temperature_range for joint in result.joints if joint.temperature_range is not None]
    widest = max((span.greatest - span.least for span in heat), default=None)
    return [
        Tile("Joints", str(len(result.joints)), f"of {len(result.joints) + len(result.not_moved)}"),
        Tile("Recordings", str(len(result.recordings))),
        Tile("Widest range of temperature", "–" if widest is None else f"{number(widest, 3)} K"),
        Tile("Highest load torque", f"{number(max(joint.load_range.greatest for joint in result.joints), 3)} {torque}"),
    ]


def _figure(
    anchor: str,
    model: DynamicModel,
    joints: Sequence[JointExperiment],
    panel: Callable[[DynamicModel, JointExperiment, bool], Panel],
    caption: str,
) -> Figure | None:
    if not joints:
        return None
    panels = [panel(model, joint, index == 0) for index, joint in enumerate(joints)]
    return panel_figure(anchor, in_rows(panels), caption)


def _speed_panel(model: DynamicModel, joint: JointExperiment, first: bool) -> Panel:
    velocity, heat, load, torque = joint.points[:, some_of(np.arange(joint.points.shape[1]), POINTS)]
    unit, speed = _joint_units(model, joint)
    span = joint.stored.temperature_range
    has_span = span is not None
    scale = {"color": packed(heat - ZERO_CELSIUS), "colorscale": "Portland"} if has_span else {"color": MEASURED}
    traces: list[dict[str, Any]] = [_points("data", velocity, torque, {**scale, "size": 3}, first)]
    level = np.sqrt(np.mean(np.square(load)))
    ends = [("model", np.nan)] if span is None else [("coldest", span.least), ("warmest", span.greatest)]
    for (name, celsius), colour in zip(ends, (MEASURED, PREDICTED), strict=False):
        fast = joint.stored.speed_range.greatest * np.linspace(0.0, 1.0, CURVE_POINTS + 1)[1:] ** 2
        curve = np.concatenate([-fast[::-1], [np.nan], fast])
        torque = friction_torque(
            model, joint, curve, np.full_like(curve, celsius + ZERO_CELSIUS), np.full_like(curve, level)
        )
        traces.append(_line(name, curve, torque, colour, first))
    return Panel(
        joint.stored.joint,
        bold(joint.stored.joint, 36),
        traces,
        x=titled(f"velocity [{speed}]"),
        y=titled(unit),
        height=PANEL,
    )


def _joint_units(model: DynamicModel, joint: JointExperiment) -> tuple[str, str]:
    """Units of a joint's torque and velocity."""
    sliding = model.sliding[model.joint_names.index(joint.stored.joint)]
    return joint_unit("N·m", sliding=sliding), joint_unit("rad/s", sliding=sliding)


def _temperature_panel(model: DynamicModel, joint: JointExperiment, first: bool) -> Panel:
    span = joint.stored.temperature_range
    assert span is not None
    axis = ZERO_CELSIUS + np.linspace(span.least, span.greatest, CURVE_POINTS)
    level = np.full_like(axis, np.sqrt(np.mean(np.square(joint.points[2]))))

    def at(speed: float) -> tuple[FloatArray, FloatArray]:
        return axis - ZERO_CELSIUS, friction_torque(model, joint, np.full_like(axis, speed), axis, level)

    unit, _ = _joint_units(model, joint)
    return _speeds_panel(joint, unit, first, joint.points[1] - ZERO_CELSIUS, at, "temperature [°C]")


def _load_panel(model: DynamicModel, joint: JointExperiment, first: bool) -> Panel:
    axis = np.linspace(joint.stored.load_range.least, joint.stored.load_range.greatest, CURVE_POINTS)
    heat = np.full_like(axis, np.mean(joint.points[1]))

    def at(speed: float) -> tuple[FloatArray, FloatArray]:
        return axis, friction_torque(model, joint, np.full_like(axis, speed), heat, axis)

    unit, _ = _joint_units(model, joint)
    return _speeds_panel(joint, unit, first, np.abs(joint.points[2]), at, f"|load torque| [{unit}]")


def _speeds_panel(
    joint: JointExperiment,
    unit: str,
    first: bool,
    abscissa: FloatArray,
    curve: Callable[[float], tuple[FloatArray, FloatArray]],
    title: str,
) -> Panel:
    """Points and curves at some speeds; friction without the offset, in the direction of motion."""
    velocity, torque = joint.points[0], joint.points[3]
    offset = joint.stored.offset or 0.0
    dissipated = np.sign(velocity) * (torque - offset)
    traces: list[dict[str, Any]] = []
    for share, colour in zip(SPEED_SHARES, SERIES_COLOURS, strict=False):
        speed = share * joint.stored.speed_range.greatest
        near = some_of(np.flatnonzero(np.abs(np.abs(velocity) - speed) < SPEED_WINDOW * speed), POINTS // 3)
        x, model = curve(speed)
        name = f"{percent(share)} of the greatest speed"
        traces.append(_points(name, abscissa[near], dissipated[near], {"color": colour, "size": 3}, False))
        traces.append(_line(name, x, model - offset, colour, first))
    return Panel(
        joint.stored.joint, bold(joint.stored.joint, 36), traces, x=titled(title), y=titled(unit), height=PANEL
    )


def percent(share: float) -> str:
    """A share that is a round number of per cent."""
    return f"{100 * share:.0f} %"


def _points(name: str, x: FloatArray, y: FloatArray, marker: dict[str, Any], shown: bool) -> dict[str, Any]:
    return points_trace(x, y, {"opacity": 0.5, **marker}, HOVER, **legend(name, shown=shown))


def _line(name: str, x: FloatArray, y: FloatArray, colour: str, shown: bool) -> dict[str, Any]:
    return curve_trace(x, y, {"color": colour, "width": 2}, HOVER, **legend(name, shown=shown))
