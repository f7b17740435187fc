"""The plots of an excitation's page over time: joints, the tool's place, and clearances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from daq.motion.trajectories import Motion, RestToRest
from daq.robot.loader import RobotFile
from daq.robot.schema import JointLimits
from drivers.core.arrays import FloatArray
from ident.excite.constraints.constraints import constraints_of
from ident.excite.constraints.placements import place_arm, tool_point
from ident.excite.constraints.self_collision import SelfCollision
from ident.excite.constraints.workspace import WorkspaceLimits
from ident.excite.path import JointPath
from ident.excite.prior import PriorKnowledge
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.regressor import model_torque
from ident.report.figures.figures import MEASURED, PREDICTED, SERIES_COLOURS, Figure, bold, plain, shortened
from ident.report.figures.panels import TIME_AXIS, Panel, panel_figure
from ident.report.figures.traces import curve_trace, points_trace

POINTS = 1200
"""Points per line."""

PANEL, TOOL_PANEL, CLEARANCE_PANEL = 110, 150, 300
"""Heights of a plot [px]."""

_LIMIT = {"color": PREDICTED, "width": 1, "dash": "dash"}


@dataclass(frozen=True)
class Shown:
    """Signals of a motion for the plots."""

    path: JointPath  # on a grid
    torque: FloatArray | None  # (n, N) of the prior parameters [N·m or N]; None without them
    repetitions: int  # how many there are in all; one of them is shown


def shown_part(robot_file: RobotFile, motion: Motion, prior: PriorKnowledge) -> Shown:
    """The approach from rest and one repetition of the motion; the whole motion where it does not repeat."""
    end, repetitions = motion.duration, 1
    if isinstance(motion, RestToRest) and motion.periods > 1:
        end, repetitions = motion.ramp + motion.motion.duration, motion.periods
    path = path_until(motion, end, POINTS)
    torque = None
    if prior.parameters is not None:
        model = build_model(robot_file)
        columns = base_parameters(model).columns
        torque = model_torque(model, columns, prior.parameters, path.position, path.velocity, path.acceleration)
    return Shown(path, torque, repetitions)


def path_until(motion: Motion, end: float, count: int) -> JointPath:
    """The motion from 0 to `end` [s]."""
    time = np.linspace(0.0, end, count)
    return JointPath(time, *motion.evaluate(time))


def joints_figure(joints: Sequence[JointLimits], shown: Shown) -> Figure:
    """Position, velocity and torque of every joint with their limits: a row per joint, a column per quantity."""
    columns = [("position", "rad", shown.path.position), ("velocity", "rad/s", shown.path.velocity)]
    if shown.torque is not None:
        columns.append(("torque", "N·m", shown.torque))
    rows = [
        [
            _joint_panel(limits, quantity, limits.unit(unit), shown.path.time, values[row])
            for quantity, unit, values in columns
        ]
        for row, limits in enumerate(joints)
    ]
    torques = " Torques are those of the prior parameters." if shown.torque is not None else ""
    caption = f"Dashed: limits of the robot file.{torques} {part_shown(shown)}"
    return panel_figure("joints-plot", rows, caption, linked=True, showlegend=False, hovermode="x")


def _joint_panel(limits: JointLimits, quantity: str, unit: str, time: FloatArray, values: FloatArray) -> Panel:
    name = bold(limits.name)
    bounds = _limits(quantity, limits)
    line = curve_trace(
        time,
        values,
        {"color": MEASURED, "width": 1.5},
        f"%{{y:.4g}} {unit}",
        name=plain(f"{quantity} of {limits.name}"),
    )
    # Shapes do not widen an axis: invisible points at the limits do.
    return Panel(
        f"{limits.name}: {quantity} [{unit}]",
        f"{name}: {quantity} [{unit}]" if quantity == "position" else f"{quantity} [{unit}]",
        [line, _invisible(time[0], bounds)] if bounds else [line],
        f"{name}: {quantity} [{unit}]",
        x=TIME_AXIS,
        y={"nticks": 4, "zeroline": False},
        horizontal=[(bound, _LIMIT) for bound in bounds],
        height=PANEL,
    )


def part_shown(shown: Shown) -> str:
    """The shown section of the motion, in words."""
    if shown.repetitions == 1:
        return "The whole motion, from rest to rest."
    return f"From rest into the motion and the first of its {shown.repetitions} repetitions."


def _limits(quantity: str, limits: JointLimits) -> tuple[float, ...]:
    if quantity == "position":
        return limits.position
    size = limits.velocity if quantity == "velocity" else limits.torque
    return () if size is None else (-size, size)


def _invisible(time: float, values: Sequence[float]) -> dict[str, Any]:
    return points_trace([float(time)] * len(values), list(values), {"opacity": 0}, showlegend=False)


def tool_figure(robot_file: RobotFile, shown: Shown) -> Figure:
    """Distance of the tool point from the base frame's z axis, and its height, with the workspace's limits."""
    model = build_model(robot_file)
    workspace = robot_file.robot.workspace
    tool = tool_point(model, place_arm(model, shown.path.position), workspace.tool)
    distance = _tool_panel("distance from the base's z axis [m]", shown, np.hypot(tool[0], tool[1]), workspace.radius)
    height = _tool_panel("height [m]", shown, tool[2], workspace.height)
    dashed = " Dashed: limits of the robot file's workspace." if workspace.radius or workspace.height else ""
    caption = f"The tool point, {_tool_words(robot_file)}.{dashed} {part_shown(shown)}"
    return panel_figure("tool-plot", [[distance], [height]], caption, linked=True, showlegend=False, hovermode="x")


def _tool_panel(label: str, shown: Shown, values: FloatArray, limits: tuple[float, float] | None) -> Panel:
    line = curve_trace(shown.path.time, values, {"color": MEASURED, "width": 1.5}, "%{y:.3f} m", name=label)
    return Panel(
        label,
        f"<b>{label}</b>",
        [line] if limits is None else [line, _invisible(shown.path.time[0], limits)],
        x=TIME_AXIS,
        y={"zeroline": False},
        horizontal=[(limit, _LIMIT) for limit in limits or ()],
        height=TOOL_PANEL,
    )


def _tool_words(robot_file: RobotFile) -> str:
    tool = robot_file.robot.workspace.tool
    if not any(tool):
        return "the origin of the last joint's frame (the robot file names no other)"
    return f"({', '.join(f'{value:g}' for value in tool)}) m in the last joint's frame"


def clearance_figure(robot_file: RobotFile, shown: Shown) -> Figure | None:
    """The smallest distance to each obstacle and limit, and between links, over time; None where none is bounded."""
    model = build_model(robot_file)
    lines: list[tuple[str, FloatArray, float]] = []
    for constraint in constraints_of(robot_file, model, None, self_collision=True):
        if isinstance(constraint, WorkspaceLimits):
            lines += [
                (clearance.name, clearance.distance, clearance.kept) for clearance in constraint.clearances(shown.path)
            ]
        elif isinstance(constraint, SelfCollision):
            lines.append(("links from each other", constraint.distances(shown.path).min(axis=0), 0.0))
    if not lines:
        return None
    traces, kept_lines = [], []
    for index, (name, distance, kept) in enumerate(lines):
        colour = SERIES_COLOURS[index % len(SERIES_COLOURS)]
        traces.append(
            curve_trace(
                shown.path.time,
                distance,
                {"color": colour, "width": 1.5},
                "%{y:.3f} m",
                name=plain(shortened(name, 30)),
            )
        )
        kept_lines.append((kept, {"color": colour, "width": 1, "dash": "dash"}))
    panel = Panel(
        "clearance [m]",
        "<b>clearance</b> [m]",
        traces,
        x=TIME_AXIS,
        y={"rangemode": "tozero", "zeroline": False},
        horizontal=kept_lines,
        height=CLEARANCE_PANEL,
    )
    caption = (
        "Distance of the nearest link, its thickness included. Dashed: the clearance that is kept; two links must not "
        f"touch. {part_shown(shown)}"
    )
    return panel_figure("clearance-plot", [[panel]], caption, hovermode="x")
