"""Half-spaces that hold a link's centre of mass: of a box, of points, or of the link's shapes in the URDF."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from drivers.core.errors import RobotFileError
from ident.model.dynamic_model import DynamicModel
from ident.model.kinematics.urdf_shapes import (
    LinkShape,
    UnusableShapeError,
    lengths,
    link_shapes,
    mesh_folders,
    mesh_vertices,
    placed_shape,
)

HULL_TOLERANCE = 0.01
"""Half-spaces are added until they enclose no point farther from the hull than this share of its size."""

MOST_HALF_SPACES = 40
"""Half-spaces of a hull at most: a round one needs about so many, each costs the solver a row."""

CORNERS = 16
"""Corners of the polygon around a circle."""

ALIKE_NORMALS = 0.05
"""Difference of facets' normals below which one of them stands for all: meshes have millions."""

FLAT = 1e-6
"""Points whose thickness is below this share of their extent lie in a plane."""

_AROUND = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if (x, y, z) != (0, 0, 0)])
"""Directions of a cube's faces, edges and corners."""


@dataclass(frozen=True)
class CentreBound:
    """The centre of mass c of a link, in the frame of its joint: normals @ c ≤ offsets."""

    link: int  # its index
    name: str  # the key of the robot file
    normals: FloatArray  # (f, 3) of length 1; the first six are those of a box, −x, −y, −z, x, y, z
    offsets: FloatArray  # (f,) [m]


def centre_bounds(model: DynamicModel, robot_file: RobotFile) -> Iterator[CentreBound]:
    """The bounds that `prior.links` of a robot file states.

    Raises:
        RobotFileError: a shape of the URDF is missing or unusable, or points lie in a plane.
    """
    robot = robot_file.robot
    of_urdf = [name for name, stated in robot.prior.links.items() if stated.com_hull == "urdf"]
    shapes = _urdf_points(model, robot_file, of_urdf) if of_urdf else {}
    for link, name in enumerate(model.link_names):
        if name not in robot.prior.links:
            continue
        stated, where = robot.prior.links[name], f"prior.links.{name}"
        if stated.com_box is not None:
            low, high = np.array(stated.com_box)
            yield CentreBound(link, f"{where}.com_box", np.vstack([-np.eye(3), np.eye(3)]), np.append(-low, high))
        if stated.com_hull is not None:
            points = shapes[name] if stated.com_hull == "urdf" else np.array(stated.com_hull)
            yield CentreBound(link, f"{where}.com_hull", *half_spaces(points, f"{robot.name}: {where}.com_hull"))


def half_spaces(points: FloatArray, where: str) -> tuple[FloatArray, FloatArray]:
    """A few half-spaces that enclose all points (V, 3), and little beyond their convex hull.

    Facets of the hull are taken one after the other, each time the one that a corner of what they enclose so far lies
    farthest outside of.

    Returns:
        Normals (f, 3) of length 1, those of a box first, and offsets (f,): normals @ point ≤ offsets.

    Raises:
        RobotFileError: the points lie in a plane; `where` names the key.
    """
    from scipy.spatial import ConvexHull, HalfspaceIntersection

    extent = np.linalg.norm(np.ptp(points, axis=0))
    middle = points.mean(axis=0)
    if not extent > 0 or np.linalg.svd(points - middle, compute_uv=False)[-1] <= FLAT * extent:
        raise RobotFileError("the points lie in a plane and enclose no volume", where=where)
    hull = ConvexHull(points)
    inside = points[hull.vertices].mean(axis=0)
    _, different = np.unique(np.round(hull.equations[:, :3] / ALIKE_NORMALS), axis=0, return_index=True)
    facets = hull.equations[different]
    chosen = np.array([(*normal, -np.max(points @ normal)) for normal in np.vstack([-np.eye(3), np.eye(3)])])
    for _ in range(MOST_HALF_SPACES - len(chosen)):
        corners = HalfspaceIntersection(chosen, inside).intersections
        outside = facets[:, :3] @ corners.T + facets[:, 3:]
        facet = int(np.argmax(outside.max(axis=1)))
        if outside[facet].max() <= HULL_TOLERANCE * extent:
            break
        chosen = np.vstack([chosen, facets[facet]])
    return chosen[:, :3], -chosen[:, 3]


def _urdf_points(model: DynamicModel, robot_file: RobotFile, wanted: Sequence[str]) -> dict[str, FloatArray]:
    """Points (V, 3) around the shapes of these links: their collision shapes, where a link has none its visual ones."""
    robot, names = robot_file.robot, model.link_names
    if not robot_file.urdf_text:
        raise RobotFileError(
            "'urdf', but the model is none", where=f"{robot.name}: prior.links.{wanted[0]}.com_hull", hint="give points"
        )
    folders = mesh_folders(robot_file)
    points: dict[str, list[FloatArray]] = {}
    for kind in ("collision", "visual"):
        having = set(points)
        for of_link in link_shapes(robot_file.urdf_text, names, robot.model.locked, robot.name, kind):
            name = names[of_link.link] if of_link.link >= 0 else ""
            if name not in wanted or name in having:
                continue
            for element in of_link.elements:
                try:
                    own = _points(placed_shape(element, of_link.placement), folders)
                except UnusableShapeError as error:
                    raise RobotFileError(
                        f"a shape of the URDF cannot be used: {error}",
                        where=f"{robot.name}: prior.links.{name}.com_hull",
                        hint="recordings and results contain no meshes: give --robot, name the folder of the "
                        "package in ROS_PACKAGE_PATH, or write points in place of 'urdf'",
                    ) from error
                points.setdefault(name, []).append(own)
    for name in wanted:
        if name not in points:
            raise RobotFileError(
                "the URDF has no shape of this link", where=f"{robot.name}: prior.links.{name}.com_hull"
            )
    return {name: np.vstack(of_link) for name, of_link in points.items()}


def _points(shape: LinkShape, folders: Sequence[Path]) -> FloatArray:
    """Points (V, 3) whose convex hull contains a shape."""
    kind = shape.element.tag
    if kind == "mesh":
        return mesh_vertices(shape, folders)
    if kind == "box":
        own = _AROUND[np.all(_AROUND != 0, axis=1)] * 0.5 * lengths(shape, "size")
    elif kind == "sphere":
        own = _ball(float(lengths(shape, "radius")[0]))
    elif kind in ("cylinder", "capsule"):
        radius, length = lengths(shape, "radius", "length")
        end = _ball(radius) if kind == "capsule" else _circle(radius)
        own = np.vstack([end + (0, 0, 0.5 * length), end - (0, 0, 0.5 * length)])
    else:
        raise UnusableShapeError(f"no known shape: {kind}")
    return np.asarray(shape.centre + own @ shape.rotation.T)


def _circle(radius: float) -> FloatArray:
    """Corners (16, 3) of a polygon around a circle in the x-y plane."""
    angle = 2 * np.pi / CORNERS * np.arange(CORNERS)
    outer = radius / np.cos(np.pi / CORNERS)
    return np.column_stack([outer * np.cos(angle), outer * np.sin(angle), np.zeros(CORNERS)])


def _ball(radius: float) -> FloatArray:
    """Corners (26, 3) of a polyhedron around a ball."""
    from scipy.spatial import ConvexHull

    corners = _AROUND / np.linalg.norm(_AROUND, axis=1)[:, None]
    return np.asarray(corners * (radius / -ConvexHull(corners).equations[:, 3].max()))
