"""The shape of an arm as capsules, for self-collision and obstacle distances.

A capsule is a straight segment with a radius. It has a distance that is smooth wherever it matters and cheap for many
samples at once, so every shape is replaced by capsules that enclose it: clear of the capsules is clear of the
shape. Where the URDF has a link's collision shapes, and its meshes can be found, they are enclosed; otherwise the link
is a tube along the straight lines from its joint's origin to the next joints' origins (with a corner where an
MDH row has one), and for the last link to the tool point. Where there are meshes, the shapes' convex hulls say more
where capsules touch (`ident.excite.constraints.hull_distance`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Literal

import numpy as np

from daq.robot.loader import RobotFile
from daq.robot.schema import BASE, MdhRow
from daq.robot.workspace import Workspace
from drivers.core.arrays import FloatArray, IndexArray
from ident.excite.constraints.hull_distance import Hull, hull_of_capsule, hull_of_points
from ident.excite.constraints.placements import Capsule, box_capsules, cylinder_capsule, enclosing_capsule
from ident.model.dynamic_model import DynamicModel
from ident.model.kinematics.joints import BASE_INDEX, Joint
from ident.model.kinematics.urdf import urdf_order
from ident.model.kinematics.urdf_shapes import (
    LinkShape,
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
    """What encloses the shapes of links, by link index."""

    capsules: Mapping[int, list[Capsule]]  # of every link that has shapes, all of which can be used
    hulls: Mapping[int, list[Hull]]  # tighter ones, of the links among these that have meshes
    unread: Mapping[int, str]  # why the shapes of others cannot be used


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


def _enclosing(link: int, shape: LinkShape, folders: Sequence[Path]) -> tuple[list[Capsule], list[Hull]]:
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
    return capsules, [hull_of_capsule(capsule) for capsule in capsules] if hull is None else [hull]


def _capsules(link: int, shape: LinkShape) -> Iterator[Capsule]:
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


DISTANCE_SCALE = 0.1
"""A distance d to what must not be touched uses 1 − d/0.1 m of its limit: all of it at contact, nothing at 0.1 m."""

_SAME_POINT = 1e-9  # [m]


@dataclass(frozen=True)
class ArmGeometry:
    """An arm's capsules."""

    capsules: tuple[Capsule, ...]  # every link has at least one; those of one link are consecutive, the base's first
    # names of the links (by joint, or `base`) whose capsules enclose shapes of the URDF; the others are tubes along
    # their axes
    from_shapes: tuple[str, ...]
    hulls: tuple[Hull, ...] = ()  # of the same shapes, links in the same order, where the URDF has meshes; else none
    unread: tuple[str, ...] = ()  # links whose shapes cannot be used, and why: `wrist: no such file: wrist.stl`

    @cached_property
    def links(self) -> IndexArray:
        """(C,) link of each capsule."""
        return np.array([capsule.link for capsule in self.capsules])

    @cached_property
    def starts(self) -> FloatArray:
        """(C, 3) [m]."""
        return np.array([capsule.start for capsule in self.capsules])

    @cached_property
    def ends(self) -> FloatArray:
        """(C, 3) [m]."""
        return np.array([capsule.end for capsule in self.capsules])

    @cached_property
    def radii(self) -> FloatArray:
        """(C,) [m]."""
        return np.array([capsule.radius for capsule in self.capsules])


def link_name(model: DynamicModel, link: int) -> str:
    """The joint that moves a link, or `base`."""
    return BASE if link == BASE_INDEX else model.joints[link].name


def arm_geometry(robot_file: RobotFile, model: DynamicModel) -> ArmGeometry:
    """The capsules of an arm.

    Raises:
        RobotFileError: the URDF and the file's joints do not fit together.
    """
    robot = robot_file.robot
    of_urdf = urdf_shapes(robot_file) if robot.model.urdf is not None else UrdfShapes({}, {}, {})
    shapes = of_urdf.capsules
    tubes = tube_capsules(model, robot.model.mdh, robot.workspace)
    capsules: list[Capsule] = []
    for link in (BASE_INDEX, *range(len(model.joints))):
        capsules += shapes.get(link) or [tube for tube in tubes if tube.link == link]
    last = model.tool_link
    tool: list[Capsule] = []
    if last in shapes and any(robot.workspace.tool):
        tool.append(_tool_tube(last, model.joints[last].name, robot.workspace))
    capsules += tool
    hulls: list[Hull] = []
    if of_urdf.hulls:
        for link in (BASE_INDEX, *range(len(model.joints))):
            hulls += of_urdf.hulls.get(link) or [
                hull_of_capsule(capsule) for capsule in capsules if capsule.link == link
            ]
        hulls += [hull_of_capsule(shape) for shape in tool if of_urdf.hulls.get(last)]
    unread = tuple(f"{link_name(model, link)}: {why}" for link, why in sorted(of_urdf.unread.items()))
    names = tuple(link_name(model, link) for link in sorted(shapes))
    return ArmGeometry(tuple(capsules), names, tuple(hulls), unread)


def tube_capsules(model: DynamicModel, rows: Sequence[MdhRow] | None, workspace: Workspace) -> tuple[Capsule, ...]:
    """Capsules along the axes of every link, with the robot file's thickness.

    Where a link carries a prismatic joint, its tube reaches to the nearer end of that joint's travel; the link behind
    the joint has a tube as long as the travel, which covers what is drawn out.
    """
    capsules = []
    radii = [workspace.radius_of(joint.name) for joint in model.joints]
    for index, joint in enumerate(model.joints):
        radius = workspace.radius_of(BASE) if joint.parent == BASE_INDEX else radii[joint.parent]
        travel = _travel(model, index)
        corners = _corners(joint, rows[index] if rows is not None else None, travel[0])
        kept = [corners[0]]
        for corner in corners[1:]:
            if np.linalg.norm(corner - kept[-1]) > _SAME_POINT:
                capsules.append(Capsule(joint.parent, kept[-1], corner, radius))
                kept.append(corner)
        if joint.prismatic:
            back = joint.axis * (travel[0] - travel[1])
            capsules.append(Capsule(index, np.zeros(3), back, radii[index]))
    if any(workspace.tool):
        capsules.append(_tool_tube(model.tool_link, model.joints[model.tool_link].name, workspace))
    present = {capsule.link for capsule in capsules}
    for link in (BASE_INDEX, *range(len(model.joints))):
        if link not in present:
            capsules.append(Capsule(link, np.zeros(3), np.zeros(3), workspace.radius_of(link_name(model, link))))
    return tuple(capsules)


def _tool_tube(link: int, name: str, workspace: Workspace) -> Capsule:
    return Capsule(link, np.zeros(3), np.array(workspace.tool), workspace.radius_of(name))


def _travel(model: DynamicModel, index: int) -> tuple[float, float]:
    """The ends of a prismatic joint's travel [m], first the one nearer to the link that carries it; 0 if revolute."""
    joint = model.joints[index]
    ends = model.limits[model.active.index(index)].position if index in model.active else (0.0, 0.0)
    if not (joint.prismatic and np.all(np.isfinite(ends))):
        return (0.0, 0.0)
    way = joint.rotation @ joint.axis
    near, far = sorted(ends, key=lambda q: float(np.linalg.norm(joint.translation + q * way)))
    return (near, far)


def _corners(joint: Joint, row: MdhRow | None, position: float) -> list[FloatArray]:
    """Vector from the parent link's origin to a joint's origin, in the parent link's frame."""
    along = joint.rotation @ joint.axis
    end = joint.translation + (position * along if joint.prismatic else 0.0)
    if row is None:
        return [np.zeros(3), end]
    # Khalil-Kleinfinger: b along z, d along x, then r along the joint's own axis.
    return [np.zeros(3), np.array([0.0, 0.0, row.b]), joint.translation - row.r * along, end]
