"""The page of a designed excitation: one self-contained HTML file."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from markupsafe import Markup

from daq.motion.trajectories import Motion
from daq.robot.loader import RobotFile
from daq.robot.obstacles import obstacles_of
from daq.robot.workspace import Box, HalfSpace
from drivers.core.arrays import FloatArray, IndexArray
from drivers.core.units import common_unit
from ident.excite.constraints.collision_geometry import ArmGeometry, arm_geometry
from ident.excite.constraints.constraints import unchecked_pairs
from ident.excite.constraints.placements import place_arm, tool_point
from ident.excite.forecast import ExcitationFigures
from ident.excite.page.plots import (
    Shown,
    clearance_figure,
    joints_figure,
    part_shown,
    path_until,
    shown_part,
    tool_figure,
)
from ident.excite.prior import PriorKnowledge
from ident.model.dynamic_model import build_model
from ident.model.kinematics.joints import BASE_INDEX, Joint
from ident.regression.options import SIGNIFICANT_RSD
from ident.report.figures.figures import ACCENT, KIND_STYLES, MEASURED, PREDICTED, RESIDUAL, Figure, base_layout, plain
from ident.report.figures.panels import ROOM, WIDE_ROOM, legend_rows
from ident.report.figures.traces import packed
from ident.report.html_file import rendered
from ident.report.section import Tile
from ident.views import number_text
from ident.views.number_text import number, percent

FRAMES = 72
"""Frames of the animation at most."""

CAMERA_X, CAMERA_Y = 1.1, 1.35
"""Places of the camera along x and y, so that the arm fills a window, and a phone."""

_SCENE_HEIGHT, _NARROW_SCENE_HEIGHT = 640, 600
_GRID_COLOUR = "#A9AEB5"
"""Readable on a light and on a dark page: scenes do not follow the page's colours."""
_SIDES = 6
_TILT = np.pi / 4.0
_BOX_SIDES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
_BOX_TRIANGLES = np.array([corners for a, b, c, d in _BOX_SIDES for corners in ((a, b, c), (a, c, d))])
"""Triangles of corners in the order of their binary numbers."""


@dataclass(frozen=True)
class AnimatedFigure(Figure):
    """A figure with frames, which the page's script adds once it is drawn."""

    frames: Sequence[dict[str, Any]] = field(default=())  # argument of Plotly.addFrames

    @property
    def frames_json(self) -> Markup:
        """The frames as strict JSON; they hold numbers and our own names only."""
        return Markup(json.dumps(list(self.frames), allow_nan=False, separators=(",", ":")))


def arm_figure(robot_file: RobotFile, motion: Motion, shown: Shown) -> AnimatedFigure:
    """The arm with its links' thickness and its surroundings, moving along the path of its tool point."""
    model = build_model(robot_file)
    end = float(shown.path.time[-1])
    count = FRAMES
    moments = path_until(motion, end, count)
    placements = place_arm(model, moments.position)
    tool = robot_file.robot.workspace.tool
    tools = tool_point(model, placements, tool)
    path = tool_point(model, place_arm(model, shown.path.position), tool)
    lines = [_arm_line(model.joints, placements.origin[:, :, k], tools[:, k]) for k in range(count)]
    tubes = capsule_mesh(arm_geometry(robot_file, model))
    vertices = placements.points(tubes.links, tubes.vertices).transpose(2, 1, 0)
    skins = [_corners_of(vertices[k]) for k in range(count)]
    frames = [
        {"name": str(k), "data": [line, skin], "traces": [1, 2]}
        for k, (line, skin) in enumerate(zip(lines, skins, strict=True))
    ]
    low, high = _bounds(placements.origin, path)
    data: list[dict[str, Any]] = [
        {
            "type": "scatter3d", "mode": "lines", "name": "path of the tool point", "x": packed(path[0]),
            "y": packed(path[1]), "z": packed(path[2]), "line": {"color": RESIDUAL, "width": 2}, "hoverinfo": "skip",
        },
        {
            "type": "scatter3d", "mode": "lines+markers", "name": "arm", **lines[0],
            "line": {"color": MEASURED, "width": 6}, "marker": {"color": PREDICTED, "size": 4}, "hoverinfo": "skip",
        },
        {
            "type": "mesh3d", "name": "links, as thick as they are checked", **skins[0],
            **_corner_numbers(tubes.triangles),
            "color": RESIDUAL, "opacity": 0.35, "flatshading": True, "hoverinfo": "skip", "showlegend": True,
        },
    ]  # fmt: skip
    for obstacle in obstacles_of(robot_file.robot):
        corners, triangles = _solid(obstacle.shape, low, high)
        data.append(
            {
                "type": "mesh3d", "name": plain(obstacle.name), **_corners_of(corners.T), **_corner_numbers(triangles),
                "color": ACCENT if obstacle.mounting else PREDICTED, "opacity": 0.25, "flatshading": True,
                "hoverinfo": "name", "showlegend": True,
            }
        )  # fmt: skip
    wait = 1000.0 * end / (count - 1)
    names = [str(trace["name"]) for trace in data]
    layout = base_layout(
        _SCENE_HEIGHT,
        scene=_scene(low, high, CAMERA_X),
        updatemenus=[_buttons(wait)],
        sliders=[_slider(moments.time)],
        margin={"l": 0, "r": 0, "t": 30 + legend_rows(names, WIDE_ROOM), "b": 90},
        dragmode="orbit",
    )
    # On a phone the slider has a line of its own below the buttons, and a finger turns the arm.
    narrow = {
        "height": _NARROW_SCENE_HEIGHT,
        "scene": _scene(low, high, CAMERA_Y),
        "margin": {"l": 0, "r": 0, "t": 60 + legend_rows(names, ROOM), "b": 150},
        "sliders": [{**_slider(moments.time), "x": 0.04, "len": 0.9, "pad": {"t": 75}}],
        "dragmode": "orbit",
    }
    caption = (
        "Lines through the origins of the joints' frames to the tool point, around them the capsules that are checked; "
        f"{count} moments, played in real time. Mounting surface and obstacles are shown where the arm is. "
        f"Drag to turn, scroll to zoom. {part_shown(shown)}"
    )
    return AnimatedFigure("arm-plot", _SCENE_HEIGHT, data, layout, caption, narrow, frames)


@dataclass(frozen=True)
class Mesh:
    """Triangles that are fixed to links."""

    links: IndexArray  # (V,) link of each vertex
    vertices: FloatArray  # (V, 3) [m] in the frame of its link
    triangles: IndexArray  # (T, 3) numbers of vertices


def capsule_mesh(geometry: ArmGeometry) -> Mesh:
    """The surface of all capsules: rings of `_SIDES` vertices around each segment, inside the true surface."""
    angle = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
    links: list[int] = []
    vertices: list[FloatArray] = []
    triangles: list[IndexArray] = []
    for capsule in geometry.capsules:
        way = capsule.end - capsule.start
        length = float(np.linalg.norm(way))
        along = way / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
        across = np.cross(along, np.eye(3)[int(np.argmin(np.abs(along)))])
        across /= np.linalg.norm(across)
        ring = np.outer(np.cos(angle), across) + np.outer(np.sin(angle), np.cross(along, across))
        first, radius = len(links), capsule.radius
        rings = [
            point + radius * (sign * np.sin(tilt) * along + np.cos(tilt) * ring)
            for point, sign, tilts in ((capsule.start, -1.0, (_TILT, 0.0)), (capsule.end, 1.0, (0.0, _TILT)))
            for tilt in tilts
        ]
        tips = np.array([capsule.start - radius * along, capsule.end + radius * along])
        vertices.append(np.concatenate([*rings, tips]))
        links += [capsule.link] * len(vertices[-1])
        low = first + np.arange(_SIDES)
        beside = first + (np.arange(_SIDES) + 1) % _SIDES
        for step in range(len(rings) - 1):
            a, b, shift = low + step * _SIDES, beside + step * _SIDES, _SIDES
            triangles += [np.column_stack([a, b, a + shift]), np.column_stack([b, b + shift, a + shift])]
        last, tip = (len(rings) - 1) * _SIDES, first + len(rings) * _SIDES
        triangles.append(np.column_stack([low, beside, np.full(_SIDES, tip)]))
        triangles.append(np.column_stack([low + last, beside + last, np.full(_SIDES, tip + 1)]))
    return Mesh(np.array(links), np.concatenate(vertices), np.concatenate(triangles))


def _solid(shape: HalfSpace | Box, low: FloatArray, high: FloatArray) -> tuple[FloatArray, IndexArray]:
    """Corners (V, 3) [m] and triangles (T, 3) of a box, or of the shown region of a plane."""
    if isinstance(shape, Box):
        corners = np.array([shape.lower, shape.upper])
        corner_indices = np.array(list(product((0, 1), repeat=3)))
        return corners[corner_indices, np.arange(3)], _BOX_TRIANGLES
    normal = np.array(shape.normal) / np.linalg.norm(shape.normal)
    middle = 0.5 * (low + high)
    centre = middle - (normal @ middle - shape.offset) * normal
    across = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    across /= np.linalg.norm(across)
    half = 0.5 * float(np.linalg.norm(high - low))
    sides = half * np.array([across, np.cross(normal, across)])
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return centre + signs @ sides, np.array([[0, 1, 2], [0, 2, 3]])


def _corners_of(vertices: FloatArray) -> dict[str, list[float]]:
    """x, y, z of vertices (3, V)."""
    return {name: np.round(values, 3).tolist() for name, values in zip("xyz", vertices, strict=True)}


def _corner_numbers(triangles: IndexArray) -> dict[str, list[int]]:
    return {name: indices.tolist() for name, indices in zip("ijk", triangles.T, strict=True)}


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


def _scene(low: FloatArray, high: FloatArray, distance: float) -> dict[str, Any]:
    def axis(index: int) -> dict[str, Any]:
        return {
            "title": {"text": f"{'xyz'[index]} [m]"}, "range": [float(low[index]), float(high[index])],
            "gridcolor": _GRID_COLOUR, "zerolinecolor": _GRID_COLOUR, "showbackground": False, "nticks": 6,
        }  # fmt: skip

    return {"aspectmode": "data", "camera": _camera(distance), "xaxis": axis(0), "yaxis": axis(1), "zaxis": axis(2)}


def _camera(distance: float) -> dict[str, Any]:
    eye = {"x": distance, "y": distance, "z": 0.5 * distance}
    return {"eye": eye, "center": {"x": 0.0, "y": 0.0, "z": -0.2}}


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


def excitation_page(
    robot_file: RobotFile,
    motion: Motion,
    prior: PriorKnowledge,
    figures: ExcitationFigures,
    notes: Sequence[tuple[str, str]],
) -> str:
    """The page of what is played: `notes` are options and outcome of its design, pairs of a name and a text."""
    shown = shown_part(robot_file, motion, prior)
    unchecked = "; ".join(unchecked_pairs(robot_file, build_model(robot_file))) or "neighbours only"
    return rendered(
        "excitation_page",
        "ident.excite.page",
        robot=robot_file.robot.name,
        tiles=_tiles(figures),
        figures=figures,
        unit=partial(common_unit, sliding=robot_file.robot.sliding),
        notes=[*notes, ("Parameters and noise", figures.prior), ("Links that are not kept apart", unchecked)],
        kinds={kind: words for kind, (words, _, _) in KIND_STYLES.items()},
        threshold=SIGNIFICANT_RSD,
        plots={
            "arm": arm_figure(robot_file, motion, shown),
            "joints": joints_figure(robot_file.robot.joints, shown),
            "tool": tool_figure(robot_file, shown),
            "clearances": clearance_figure(robot_file, shown),
        },
    )


def _tiles(figures: ExcitationFigures) -> list[Tile]:
    forecast = figures.forecast
    rsds = [p.rsd_percent for p in forecast.parameters if p.rsd_percent is not None]
    significant = sum(value < SIGNIFICANT_RSD for value in rsds)
    count = len(forecast.parameters)
    return [
        Tile("Duration", f"{number(figures.duration, 4)} s", "from rest to rest"),
        Tile("Condition number", number(forecast.scaled_condition, 3), "columns of unit length; below 50 is good"),
        Tile("Condition", number(forecast.condition, 3), "depends on units"),
        Tile("Largest limit utilisation", percent(figures.worst_use), _worst(figures)),
        Tile("Significant", str(significant) if rsds else number_text.DASH, _significance(rsds, count)),
    ]


def _worst(figures: ExcitationFigures) -> str:
    return f"{figures.worst_limit}, at {number(figures.worst_time, 3)} s"


def _significance(rsds: Sequence[float], count: int) -> str:
    if not rsds:
        return "without prior parameters no relative standard deviation can be predicted"
    return f"of {count}: predicted RSD below {SIGNIFICANT_RSD:g} %"
