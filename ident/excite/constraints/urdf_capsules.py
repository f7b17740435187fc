"""Collision shapes of a URDF as capsules: primitives, and meshes where their files can be found."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal

from daq.robot.loader import RobotFile
from ident.excite.constraints.capsules import Capsule, box_capsules, cylinder_capsule, enclosing_capsule
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


def urdf_capsules(robot_file: RobotFile) -> dict[int, list[Capsule]]:
    """Capsules around the shapes of every link that has shapes, all of which can be used, by link index.

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
    for kind in KINDS:
        capsules_of: dict[int, list[Capsule]] = {}
        unusable = set(usable)
        for shapes in link_shapes(xml, names, robot.model.locked, where, kind):
            for element in shapes.elements if shapes.link not in unusable else ():
                try:
                    capsules = _capsules(shapes.link, placed_shape(element, shapes.placement), folders)
                    capsules_of.setdefault(shapes.link, []).extend(capsules)
                except UnusableShapeError:
                    unusable.add(shapes.link)
        usable |= {link: capsules for link, capsules in capsules_of.items() if link not in unusable and capsules}
    return usable


def _capsules(link: int, shape: Shape, folders: Sequence[Path]) -> Iterator[Capsule]:
    kind = shape.element.tag
    if kind == "box":
        yield from box_capsules(link, shape.rotation, shape.centre, lengths(shape, "size").tolist())
    elif kind == "sphere":
        yield cylinder_capsule(link, shape.rotation, shape.centre, float(lengths(shape, "radius")[0]), 0.0)
    elif kind in ("cylinder", "capsule"):
        radius, length = lengths(shape, "radius", "length")
        yield cylinder_capsule(link, shape.rotation, shape.centre, float(radius), float(length))
    elif kind == "mesh":
        yield enclosing_capsule(link, mesh_vertices(shape, folders))
    else:
        raise UnusableShapeError(f"no known shape: {kind}")
