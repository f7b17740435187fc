"""Collision shapes of a URDF as capsules: primitives, and meshes where their files can be found."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from daq.robot.loader import RobotFile
from drivers.errors import UsageError
from drivers.input_files import MESH_FILE, check_input
from drivers.streams import FloatArray
from ident.excite.constraints.capsules import Capsule, box_capsules, cylinder_capsule, enclosing_capsule
from ident.model.kinematics.joints import BASE_INDEX
from ident.model.kinematics.urdf import UNIVERSE, urdf_model, urdf_order

_PACKAGE_PATHS = ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH")
"""Environment variables with the folders of ROS packages, ROS 1 and ROS 2."""


class _UnusableShapeError(Exception):
    """A shape that is no shape, or whose mesh cannot be found or read."""


def urdf_capsules(robot_file: RobotFile) -> dict[int, list[Capsule]]:
    """Capsules around the collision shapes of every link that has shapes, all of which can be used, by link index.

    Links that are fixed to each other count as one; if one shape of theirs cannot be used, none is.

    Raises:
        RobotFileError: the URDF and the file's joints do not fit together.
    """
    robot = robot_file.robot
    xml = robot_file.urdf_text or ""
    where, names = f"{robot_file.where}: {robot.model.urdf}", robot.joint_names
    if robot.passive_names:
        names = urdf_order(xml, (*names, *robot.passive_names), robot.model.locked, where)
    model = urdf_model(xml, names, robot.model.locked, where)
    folders = _folders(robot_file)
    capsules_of: dict[int, list[Capsule]] = {}
    unusable: set[int] = set()
    for element in ElementTree.fromstring(xml).findall("link"):
        name = element.get("name", "")
        if not model.existBodyName(name):
            continue
        frame = model.frames[model.getBodyId(name)]
        parent = frame.parentJoint
        link = BASE_INDEX if parent == UNIVERSE else names.index(model.names[parent])
        for collision in element.findall("collision"):
            try:
                capsules_of.setdefault(link, []).extend(_capsules(link, collision, frame.placement, folders))
            except _UnusableShapeError:
                unusable.add(link)
    return {link: capsules for link, capsules in capsules_of.items() if link not in unusable and capsules}


def _folders(robot_file: RobotFile) -> tuple[Path, ...]:
    """Where a mesh may lie: at the URDF, in a folder above it, in a known package."""
    folders: list[Path] = []
    if robot_file.folder is not None:
        own = (robot_file.folder / Path(robot_file.robot.model.urdf or "").expanduser()).parent
        folders += [own, *list(own.resolve().parents)[:3]]
    for variable in _PACKAGE_PATHS:
        for entry in filter(None, os.environ.get(variable, "").split(os.pathsep)):
            folders += [Path(entry), Path(entry) / "share"]
    return tuple(folders)


def _capsules(link: int, collision: Any, frame: Any, folders: tuple[Path, ...]) -> Iterator[Capsule]:
    origin = collision.find("origin")
    shift, angles = np.zeros(3), np.zeros(3)
    if origin is not None:
        shift, angles = _numbers(origin.get("xyz", "0 0 0"), 3), _numbers(origin.get("rpy", "0 0 0"), 3)
    rotation = np.asarray(frame.rotation) @ Rotation.from_euler("xyz", angles).as_matrix()
    centre = np.asarray(frame.rotation) @ shift + np.asarray(frame.translation)
    geometry = collision.find("geometry")
    shape = next(iter(geometry), None) if geometry is not None else None
    if shape is None:
        raise _UnusableShapeError("a collision without a shape")
    if shape.tag == "box":
        yield from box_capsules(link, rotation, centre, _positive(shape.get("size", ""), 3).tolist())
    elif shape.tag == "sphere":
        yield cylinder_capsule(link, rotation, centre, float(_positive(shape.get("radius", ""), 1)[0]), 0.0)
    elif shape.tag in ("cylinder", "capsule"):
        radius, length = _positive(f"{shape.get('radius', '')} {shape.get('length', '')}", 2)
        yield cylinder_capsule(link, rotation, centre, float(radius), float(length))
    elif shape.tag == "mesh":
        vertices = _mesh_vertices(shape.get("filename", ""), folders)
        scaled = vertices * _numbers(shape.get("scale", "1 1 1"), 3)
        yield enclosing_capsule(link, centre + scaled @ rotation.T)
    else:
        raise _UnusableShapeError(f"no known shape: {shape.tag}")


def _numbers(text: str, count: int) -> FloatArray:
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError as error:
        raise _UnusableShapeError(f"no numbers: {text}") from error
    if values.shape != (count,) or not np.all(np.isfinite(values)):
        raise _UnusableShapeError(f"not {count} finite numbers: {text}")
    return values


def _positive(text: str, count: int) -> FloatArray:
    values = _numbers(text, count)
    if not np.all(values > 0):
        raise _UnusableShapeError(f"not above 0: {text}")
    return values


def _mesh_vertices(filename: str, folders: tuple[Path, ...]) -> FloatArray:
    """(V, 3) of a mesh file that a URDF names (`package://…`, `file://…` or a path)."""
    plain = filename.removeprefix("file://")
    within = filename.removeprefix("package://")
    try:
        # Where the package's own folder is searched, its name is not part of the path any more.
        inside = [within, within.partition("/")[2]] if filename.startswith("package://") else [plain]
        candidates = [folder / path for folder in folders for path in inside if path]
        candidates += [Path(plain)] if Path(plain).is_absolute() else []
        path = next((candidate for candidate in candidates if candidate.is_file()), None)
    except (OSError, ValueError) as error:  # a name too long, or a NUL in it
        raise _UnusableShapeError(f"no such file: {filename}") from error
    if path is None:
        raise _UnusableShapeError(f"no such file: {filename}")
    import coal

    try:
        check_input(path, MESH_FILE, UsageError)
    except UsageError as error:
        raise _UnusableShapeError(str(error)) from error
    try:
        vertices = np.array(coal.MeshLoader().load(str(path), np.ones(3)).vertices(), dtype=np.float64)
    except Exception as error:  # Coal and its mesh readers raise several kinds, none of them public
        raise _UnusableShapeError(f"not a mesh: {path}") from error
    if vertices.ndim != 2 or vertices.shape[1] != 3 or len(vertices) == 0 or not np.all(np.isfinite(vertices)):
        raise _UnusableShapeError(f"no points in {path}")
    return vertices
