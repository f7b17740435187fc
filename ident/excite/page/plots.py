"""The plots of an excitation's page: joints over time, the tool's place, and the arm in motion."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from markupsafe import Markup

from daq.motion.trajectories import Motion, RestToRest
from daq.robot.loader import RobotFile
from daq.robot.schema import JointLimits
from drivers.streams import FloatArray
from ident.excite.constraints.placements import place_arm, tool_point
from ident.excite.path import Path
from ident.excite.prior import Prior
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.joints import BASE_INDEX, Joint
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

FRAMES = 100
"""Frames of the animation at most."""

PANEL, GAP = 110, 34
_COLUMN_GAP = 0.07
_SCENE_HEIGHT = 640
_GRID_COLOUR = "#A9AEB5"
"""Readable on a light and on a dark page: scenes do not take the page's colours."""


@dataclass(frozen=True)
class AnimatedFigure(Figure):
    """A figure with frames, which the page's script adds once it is drawn.

    Attributes:
        frames: what Plotly.addFrames takes.
    """

    frames: Sequence[dict[str, Any]] = field(default=())

    @property
    def frames_json(self) -> Markup:
        """The frames as strict JSON; they hold numbers and our own names only."""
        return Markup(json.dumps(list(self.frames), allow_nan=False, separators=(",", ":")))


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
    path = _path(motion, end, POINTS)
    torque = None
    if prior.parameters is not None:
        model = build_model(robot_file)
        columns = base_parameters(model).columns
        torque = model_torque(model, columns, prior.parameters, path.position, path.velocity, path.acceleration)
    return Shown(path, torque, repetitions)


def _path(motion: Motion, end: float, count: int) -> Path:
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
    return Figure("joints-plot", height, data, layout, f"Dashed: limits of the robot file.{torques} {_part(shown)}")


def _part(shown: Shown) -> str:
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
    caption = f"The tool point, {_tool_words(robot_file)}.{dashed} {_part(shown)}"
    return Figure("tool-plot", height, data, layout, caption)


def _tool_words(robot_file: RobotFile) -> str:
    tool = robot_file.robot.workspace.tool
    if not any(tool):
        return "the origin of the last joint's frame (the robot file names no other)"
    return f"({', '.join(f'{value:g}' for value in tool)}) m in the last joint's frame"


def arm_figure(robot_file: RobotFile, motion: Motion, shown: Shown) -> AnimatedFigure:
    """The arm as lines through the joints' origins, moving along the path of its tool point."""
    model = build_model(robot_file)
    end = float(shown.path.time[-1])
    count = FRAMES
    moments = _path(motion, end, count)
    placements = place_arm(model, moments.position)
    tool = robot_file.robot.workspace.tool
    tools = tool_point(model, placements, tool)
    path = tool_point(model, place_arm(model, shown.path.position), tool)
    lines = [_arm_line(model.joints, placements.origin[:, :, k], tools[:, k]) for k in range(count)]
    frames = [{"name": str(k), "data": [line], "traces": [1]} for k, line in enumerate(lines)]
    low, high = _bounds(placements.origin, path)
    data: list[dict[str, Any]] = [
        {
            "type": "scatter3d", "mode": "lines", "name": "path of the tool point", "x": packed(path[0]),
            "y": packed(path[1]), "z": packed(path[2]), "line": {"color": RESIDUAL, "width": 2}, "hoverinfo": "skip",
        },
        {
            "type": "scatter3d", "mode": "lines+markers", "name": "arm", **lines[0],
            "line": {"color": MEASURED, "width": 8}, "marker": {"color": PREDICTED, "size": 4}, "hoverinfo": "skip",
        },
    ]  # fmt: skip
    wait = 1000.0 * end / (count - 1)
    layout = base_layout(
        _SCENE_HEIGHT,
        scene=_scene(low, high),
        updatemenus=[_buttons(wait)],
        sliders=[_slider(moments.time)],
        margin={"l": 0, "r": 0, "t": 30, "b": 90},
    )
    caption = (
        f"Lines through the origins of the joints' frames to the tool point; {count} moments, played in real time. "
        f"Drag to turn, scroll to zoom. {_part(shown)}"
    )
    return AnimatedFigure("arm-plot", _SCENE_HEIGHT, data, layout, caption, frames)


def _arm_line(joints: tuple[Joint, ...], origins: FloatArray, tool: FloatArray) -> dict[str, list[float | None]]:
    """x, y, z of the pieces from each joint's parent to the joint, then to the tool; null between branches."""
    points: list[FloatArray | None] = []
    last: int | None = None
    for index, joint in enumerate(joints):
        if joint.parent != last:
            points += [None] if points else []
            points.append(origins[joint.parent] if joint.parent != BASE_INDEX else origins[-1])
        points.append(origins[index])
        last = index
    points.append(tool)
    return {
        name: [None if point is None else round(float(point[axis]), 4) for point in points]
        for axis, name in enumerate("xyz")
    }


def _bounds(origins: FloatArray, path: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lower and upper corner (3,) [m] of all that is shown, the base included, with some room."""
    low = np.minimum(origins.min(axis=(0, 2)), path.min(axis=1))
    high = np.maximum(origins.max(axis=(0, 2)), path.max(axis=1))
    room = 0.05 * float(np.max(high - low)) + 1e-3
    return low - room, high + room


def _scene(low: FloatArray, high: FloatArray) -> dict[str, Any]:
    def axis(index: int) -> dict[str, Any]:
        return {
            "title": {"text": f"{'xyz'[index]} [m]"}, "range": [float(low[index]), float(high[index])],
            "gridcolor": _GRID_COLOUR, "zerolinecolor": _GRID_COLOUR, "showbackground": False, "nticks": 6,
        }  # fmt: skip

    camera = {"eye": {"x": 1.5, "y": 1.5, "z": 0.7}, "center": {"x": 0.0, "y": 0.0, "z": -0.12}}
    return {"aspectmode": "data", "camera": camera, "xaxis": axis(0), "yaxis": axis(1), "zaxis": axis(2)}


def _buttons(wait: float) -> dict[str, Any]:
    play = {"frame": {"duration": wait, "redraw": True}, "transition": {"duration": 0}, "fromcurrent": True}
    stop = {"frame": {"duration": 0, "redraw": True}, "mode": "immediate", "transition": {"duration": 0}}
    return {
        "type": "buttons", "direction": "left", "showactive": False, "x": 0.02, "y": 0, "xanchor": "left",
        "yanchor": "top", "pad": {"t": 30},
        "buttons": [
            {"label": "Play", "method": "animate", "args": [None, play]},
            {"label": "Pause", "method": "animate", "args": [[None], stop]},
        ],
    }  # fmt: skip


def _slider(times: FloatArray) -> dict[str, Any]:
    show = {"frame": {"duration": 0, "redraw": True}, "mode": "immediate", "transition": {"duration": 0}}
    return {
        "active": 0, "x": 0.2, "len": 0.78, "y": 0, "yanchor": "top", "pad": {"t": 20},
        "currentvalue": {"prefix": "time [s]: ", "font": {"size": 12}}, "ticklen": 3, "font": {"size": 10},
        "steps": [
            {"label": f"{time:.2f}", "method": "animate", "args": [[str(index)], show]}
            for index, time in enumerate(times)
        ],
    }  # fmt: skip
