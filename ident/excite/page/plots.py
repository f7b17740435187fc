"""The plots of an excitation's page over time: joints, the tool's place, and clearances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from daq.motion.trajectories import Motion, RestToRest
from daq.robot.loader import RobotFile
from daq.robot.schema import JointLimits
from drivers.streams import FloatArray
from ident.excite.constraints.constraints import constraints_of
from ident.excite.constraints.placements import place_arm, tool_point
from ident.excite.constraints.self_collision import SelfCollision
from ident.excite.constraints.workspace import WorkspaceLimits
from ident.excite.path import Path
from ident.excite.prior import Prior
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.regressor import model_torque
from ident.report.figures import (
    BOTTOM,
    MEASURED,
    PREDICTED,
    RESIDUAL,
    TOP,
    Figure,
    axis_name,
    axis_ref,
    base_layout,
    note,
    plain,
    row_domains,
)
from ident.report.traces import packed

POINTS = 1200
"""Points per line."""

PANEL, GAP = 110, 34
_COLUMN_GAP = 0.07
_COLOURS = (MEASURED, PREDICTED, "#009E73", "#CC79A7", "#E69F00", "#56B4E9", RESIDUAL)
"""Of lines that share a panel (Okabe and Ito); they repeat."""


@dataclass(frozen=True)
class Shown:
    """What the plots show of a motion.

    Attributes:
        path: on a grid.
        torque: (n, N) of the prior parameters [N·m or N]; None without them.
        repetitions: how many there are in all; one of them is shown.
    """

    path: Path
    torque: FloatArray | None
    repetitions: int


def shown_part(robot_file: RobotFile, motion: Motion, prior: Prior) -> Shown:
    """The way from rest into the motion and one repetition of it; all of it where it does not repeat."""
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


def path_until(motion: Motion, end: float, count: int) -> Path:
    """The motion from 0 to `end` [s]."""
    time = np.linspace(0.0, end, count)
    return Path(time, *motion.evaluate(time))


def joints_figure(joints: Sequence[JointLimits], prismatic: Sequence[bool], shown: Shown) -> Figure:
    """Position, velocity and torque of every joint with their limits: a row per joint, a column per quantity."""
    columns: list[tuple[str, FloatArray]] = [("position", shown.path.position), ("velocity", shown.path.velocity)]
    if shown.torque is not None:
        columns.append(("torque", shown.torque))
    height = TOP + BOTTOM + PANEL * len(joints) + GAP * (len(joints) - 1)
    rows = row_domains(len(joints), height, GAP)
    width = (1.0 - _COLUMN_GAP * (len(columns) - 1)) / len(columns)
    axes: dict[str, Any] = {}
    data: list[dict[str, Any]] = []
    shapes, notes = [], []
    for column, (quantity, values) in enumerate(columns):
        left = column * (width + _COLUMN_GAP)
        axes[axis_name("x", column + 1)] = {
            "domain": [left, min(1.0, left + width)],
            "anchor": axis_ref("y", column * len(joints) + len(joints)),
            "title": {"text": "time [s]"},
            "zeroline": False,
            **({"matches": "x"} if column else {}),
        }
        for row, (limits, domain) in enumerate(zip(joints, rows, strict=True)):
            index = column * len(joints) + row + 1
            x, y = axis_ref("x", column + 1), axis_ref("y", index)
            unit = _unit(quantity, prismatic[row])
            axes[axis_name("y", index)] = {"domain": list(domain), "anchor": x, "nticks": 4, "zeroline": False}
            data.append(
                {
                    "type": "scatter", "mode": "lines", "name": plain(f"{quantity} of {limits.name}"),
                    "showlegend": False, "x": packed(shown.path.time), "y": packed(values[row]), "xaxis": x, "yaxis": y,
                    "line": {"color": MEASURED, "width": 1.5}, "hovertemplate": f"%{{y:.4g}} {unit}",
                }
            )  # fmt: skip
            heading = f"<b>{plain(limits.name)}</b> [{unit}]" if column == 0 else f"[{unit}]"
            notes.append(note(f"{quantity} · {heading}" if row == 0 else heading, left, domain[1], font={"size": 11}))
            shapes += [_limit_line(x, y, limit) for limit in _limits(quantity, limits)]
            # Shapes do not widen an axis: invisible points at the limits do.
            if _limits(quantity, limits):
                data.append(_invisible(x, y, shown.path.time[0], _limits(quantity, limits)))
    layout = base_layout(height, showlegend=False, hovermode="x", annotations=notes, shapes=shapes, **axes)
    torques = " Torques are those of the prior parameters." if shown.torque is not None else ""
    return Figure(
        "joints-plot", height, data, layout, f"Dashed: limits of the robot file.{torques} {part_shown(shown)}"
    )


def part_shown(shown: Shown) -> str:
    """Which part of the motion is shown, in words."""
    if shown.repetitions == 1:
        return "The whole motion, from rest to rest."
    return f"From rest into the motion and the first of its {shown.repetitions} repetitions."


def _unit(quantity: str, prismatic: bool) -> str:
    return {"position": ("rad", "m"), "velocity": ("rad/s", "m/s"), "torque": ("N·m", "N")}[quantity][prismatic]


def _limits(quantity: str, limits: JointLimits) -> tuple[float, ...]:
    if quantity == "position":
        return limits.position
    size = limits.velocity if quantity == "velocity" else limits.torque
    return () if size is None else (-size, size)


def _limit_line(x: str, y: str, value: float) -> dict[str, Any]:
    return {
        "type": "line", "xref": f"{x} domain", "x0": 0, "x1": 1, "yref": y, "y0": value, "y1": value,
        "line": {"color": PREDICTED, "width": 1, "dash": "dash"},
    }  # fmt: skip


def _invisible(x: str, y: str, time: float, values: Sequence[float]) -> dict[str, Any]:
    return {
        "type": "scatter", "mode": "markers", "x": [float(time)] * len(values), "y": list(values), "xaxis": x,
        "yaxis": y, "showlegend": False, "hoverinfo": "skip", "marker": {"opacity": 0},
    }  # fmt: skip


def tool_figure(robot_file: RobotFile, shown: Shown) -> Figure:
    """Distance of the tool point from the base frame's z axis, and its height, with the workspace's limits."""
    model = build_model(robot_file)
    workspace = robot_file.robot.workspace
    tool = tool_point(model, place_arm(model, shown.path.position), workspace.tool)
    panels = (
        ("distance from the base's z axis [m]", np.hypot(tool[0], tool[1]), workspace.radius),
        ("height [m]", tool[2], workspace.height),
    )
    height = TOP + BOTTOM + 150 * len(panels) + GAP
    axes: dict[str, Any] = {"xaxis": {"title": {"text": "time [s]"}, "anchor": "y2", "zeroline": False}}
    data: list[dict[str, Any]] = []
    shapes, notes = [], []
    domains = row_domains(len(panels), height, GAP)
    for index, ((label, values, limits), domain) in enumerate(zip(panels, domains, strict=True), 1):
        y = axis_ref("y", index)
        axes[axis_name("y", index)] = {"domain": list(domain), "anchor": "x", "nticks": 5, "zeroline": False}
        data.append(
            {
                "type": "scatter", "mode": "lines", "name": label, "x": packed(shown.path.time), "y": packed(values),
                "yaxis": y, "line": {"color": MEASURED, "width": 1.5}, "hovertemplate": "%{y:.3f} m",
            }
        )  # fmt: skip
        notes.append(note(f"<b>{label}</b>", 0, domain[1], font={"size": 11}))
        if limits is not None:
            shapes += [_limit_line("x", y, limit) for limit in limits]
            data.append(_invisible("x", y, shown.path.time[0], limits))
    layout = base_layout(height, showlegend=False, hovermode="x", annotations=notes, shapes=shapes, **axes)
    dashed = " Dashed: limits of the robot file's workspace." if workspace.radius or workspace.height else ""
    caption = f"The tool point, {_tool_words(robot_file)}.{dashed} {part_shown(shown)}"
    return Figure("tool-plot", height, data, layout, caption)


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
            lines += [(found.name, found.distance, found.kept) for found in constraint.clearances(shown.path)]
        elif isinstance(constraint, SelfCollision):
            lines.append(("links from each other", constraint.distances(shown.path).min(axis=0), 0.0))
    if not lines:
        return None
    height = TOP + BOTTOM + 300
    data, shapes = [], []
    for index, (name, distance, kept) in enumerate(lines):
        colour = _COLOURS[index % len(_COLOURS)]
        data.append(
            {
                "type": "scatter", "mode": "lines", "name": plain(name), "x": packed(shown.path.time),
                "y": packed(distance), "xaxis": "x", "yaxis": "y", "line": {"color": colour, "width": 1.5},
                "hovertemplate": "%{y:.3f} m",
            }
        )  # fmt: skip
        shapes.append({**_limit_line("x", "y", kept), "line": {"color": colour, "width": 1, "dash": "dash"}})
    axes = {
        "xaxis": {"title": {"text": "time [s]"}, "anchor": "y", "zeroline": False},
        "yaxis": {"title": {"text": "clearance [m]"}, "anchor": "x", "rangemode": "tozero", "zeroline": False},
    }
    layout = base_layout(height, hovermode="x", shapes=shapes, **axes)
    caption = (
        "Distance of the nearest link, its thickness included. Dashed: the clearance that is kept; two links must not "
        f"touch. {part_shown(shown)}"
    )
    return Figure("clearance-plot", height, data, layout, caption)
