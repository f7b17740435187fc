"""Collision shapes of a URDF as capsules and convex hulls: primitives, and meshes where their files can be found."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Literal

import numpy as np

from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from ident.excite.constraints.capsules import Capsule, box_capsules, cylinder_capsule, enclosing_capsule
from ident.excite.constraints.hulls import Hull, hull_of_capsule, hull_of_points
from ident.model.kinematics.urdf import urdf_order
from ident.model.kinematics.urdf_shapes import (
    Shape,
    UnusableShapeError,
    lengths,
    link_shapes,
    mesh_folders,
    mesh_vertices,
    placed_shape,
)

KINDS: tuple[Literal["collision", "visual"], ...] = ("collision", "visual")


@dataclass(frozen=True)
class UrdfShapes:
    """What encloses the shapes of links, by link index.

    Attributes:
        capsules: of every link that has shapes, all of which can be used.
        hulls: tighter ones, of the links among these that have meshes.
        unread: why the shapes of others cannot be used.
    """

    capsules: Mapping[int, list[Capsule]]
    hulls: Mapping[int, list[Hull]]
    unread: Mapping[int, str]


def urdf_shapes(robot_file: RobotFile) -> UrdfShapes:
    """Capsules and hulls around the shapes of a URDF's links.

    Its collision shapes, or the visual ones of a link whose collision shapes are missing or cannot be used.

    Links that are fixed to each other count as one; if one shape of theirs cannot be used, none is.

    Raises:
        RobotFileError: the URDF and the file's joints do not fit together.
    """
    robot = robot_file.robot
    xml = robot_file.urdf_text or ""
    where, names = f"{robot_file.where}: {robot.model.urdf}", robot.joint_names
    if robot.passive_names:
        names = urdf_order(xml, (*names, *robot.passive_names), robot.model.locked, where)
    folders = mesh_folders(robot_file)
    usable: dict[int, list[Capsule]] = {}
    tight: dict[int, list[Hull]] = {}
    unread: dict[int, str] = {}
    for kind in KINDS:
        capsules_of: dict[int, list[Capsule]] = {}
        hulls_of: dict[int, list[Hull]] = {}
        unusable = set(usable)
        meshed: set[int] = set()
        for shapes in link_shapes(xml, names, robot.model.locked, where, kind):
            for element in shapes.elements if shapes.link not in unusable else ():
                try:
                    shape = placed_shape(element, shapes.placement)
                    capsules, hulls = _enclosing(shapes.link, shape, folders)
                except UnusableShapeError as error:
                    unusable.add(shapes.link)
                    unread.setdefault(shapes.link, str(error))
                    continue
                capsules_of.setdefault(shapes.link, []).extend(capsules)
                hulls_of.setdefault(shapes.link, []).extend(hulls)
                meshed |= {shapes.link} if shape.element.tag == "mesh" else set()
        fresh = {link: capsules for link, capsules in capsules_of.items() if link not in unusable and capsules}
        usable |= fresh
        tight |= {link: hulls_of[link] for link in fresh if link in meshed}
    return UrdfShapes(usable, tight, {link: why for link, why in unread.items() if link not in usable})


def _enclosing(link: int, shape: Shape, folders: Sequence[Path]) -> tuple[list[Capsule], list[Hull]]:
    """Capsules around a shape, and its hull, or the capsules' where it has no tighter one."""
    kind = shape.element.tag
    points: FloatArray | None = None
    if kind == "mesh":
        points = mesh_vertices(shape, folders)
        capsules = [enclosing_capsule(link, points)]
    else:
        capsules = list(_capsules(link, shape))
        if kind == "box":
            corners = np.array(list(product((-0.5, 0.5), repeat=3))) * lengths(shape, "size")
            points = shape.centre + corners @ shape.rotation.T
    hull = None if points is None else hull_of_points(link, points)
    return capsules, [hull_of_capsule(one) for one in capsules] if hull is None else [hull]


def _capsules(link: int, shape: Shape) -> Iterator[Capsule]:
    kind = shape.element.tag
    if kind == "box":
        yield from box_capsules(link, shape.rotation, shape.centre, lengths(shape, "size").tolist())
    elif kind == "sphere":
        yield cylinder_capsule(link, shape.rotation, shape.centre, float(lengths(shape, "radius")[0]), 0.0)
    elif kind in ("cylinder", "capsule"):
        radius, length = lengths(shape, "radius", "length")
        yield cylinder_capsule(link, shape.rotation, shape.centre, float(radius), float(length))
    else:
        raise UnusableShapeError(f"no known shape: {kind}")
