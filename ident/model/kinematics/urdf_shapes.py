"""Shapes of a URDF's links in the frames of their joints: primitives, and meshes where their files can be found."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal
from xml.etree import ElementTree

import numpy as np

from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from drivers.core.files import MESH_FILE, check_input
from drivers.core.reading_process import read_apart
from ident.linear_algebra.vectors import rotation_of
from ident.model.kinematics.joints import BASE_INDEX
from ident.model.kinematics.urdf import UNIVERSE, urdf_model

_PACKAGE_PATHS = ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH")
"""Environment variables with the folders of ROS packages, ROS 1 and ROS 2."""

_MESH_TIME = 5.0
"""Processor time [s] for one mesh."""


class UnusableShapeError(Exception):
    """A shape that is no shape, or whose mesh cannot be found or read."""


@dataclass(frozen=True)
class LinkShapes:
    """The shapes of one link of a URDF."""

    link: int  # index of the joint that moves it, `BASE_INDEX` for the base; links fixed to each other share one
    placement: Any  # Pinocchio's placement of the link in that joint's frame
    elements: tuple[ElementTree.Element, ...]  # `collision` or `visual` elements


@dataclass(frozen=True)
class LinkShape:
    """One shape in the frame of the joint that moves it."""

    rotation: FloatArray  # (3, 3) of its own axes
    centre: FloatArray  # (3,) its origin [m]
    element: ElementTree.Element  # `box`, `sphere`, `cylinder`, `capsule` or `mesh` with its attributes


def link_shapes(
    xml: str, names: Sequence[str], locked: Mapping[str, float], where: str, kind: Literal["collision", "visual"]
) -> Iterator[LinkShapes]:
    """Every link's shapes, links in the order of the file.

    Raises:
        RobotFileError: the URDF and the joints do not fit together.
    """
    model = urdf_model(xml, names, locked, where)
    for element in ElementTree.fromstring(xml).findall("link"):
        name = element.get("name", "")
        if not model.existBodyName(name):
            continue
        frame = model.frames[model.getBodyId(name)]
        parent = frame.parentJoint
        link = BASE_INDEX if parent == UNIVERSE else names.index(model.names[parent])
        yield LinkShapes(link, frame.placement, tuple(element.findall(kind)))


def placed_shape(element: ElementTree.Element, placement: Any) -> LinkShape:
    """The shape of a `collision` or `visual` element.

    Raises:
        UnusableShapeError: it has none, or its origin is not six numbers.
    """
    origin = element.find("origin")
    shift, angles = np.zeros(3), np.zeros(3)
    if origin is not None:
        shift, angles = numbers(origin.get("xyz", "0 0 0"), 3), numbers(origin.get("rpy", "0 0 0"), 3)
    rotation = np.asarray(placement.rotation) @ rotation_of(*angles)
    centre = np.asarray(placement.rotation) @ shift + np.asarray(placement.translation)
    geometry = element.find("geometry")
    shape = next(iter(geometry), None) if geometry is not None else None
    if shape is None:
        raise UnusableShapeError("a link's shape without geometry")
    return LinkShape(rotation, centre, shape)


def numbers(text: str, count: int) -> FloatArray:
    """Read so many finite numbers (count,) of an attribute.

    Raises:
        UnusableShapeError: it has others.
    """
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError as error:
        raise UnusableShapeError(f"no numbers: {text}") from error
    if values.shape != (count,) or not np.all(np.isfinite(values)):
        raise UnusableShapeError(f"not {count} finite numbers: {text}")
    return values


def lengths(shape: LinkShape, *names: str) -> FloatArray:
    """Positive lengths [m] of a primitive's attributes; of a box's `size`, three.

    Raises:
        UnusableShapeError: they are not positive numbers.
    """
    text = " ".join(shape.element.get(name, "") for name in names)
    values = numbers(text, 3 if names == ("size",) else len(names))
    if not np.all(values > 0):
        raise UnusableShapeError(f"not above 0: {text}")
    return values


def mesh_folders(robot_file: RobotFile) -> tuple[Path, ...]:
    """Return where a mesh may lie: at the URDF, in a folder above it, in a known package."""
    folders: list[Path] = []
    if robot_file.folder is not None:
        own = (robot_file.folder / Path(robot_file.robot.model.urdf or "").expanduser()).parent
        folders += [own, *list(own.resolve().parents)[:3]]
    for variable in _PACKAGE_PATHS:
        for entry in filter(None, os.environ.get(variable, "").split(os.pathsep)):
            folders += [Path(entry), Path(entry) / "share"]
    return tuple(folders)


def mesh_vertices(shape: LinkShape, folders: Sequence[Path]) -> FloatArray:
    """Vertices (V, 3) [m] of a mesh (STL, OBJ, DAE and what else Coal reads) in the frame of the joint.

    Raises:
        UnusableShapeError: the file (`package://…`, `file://…` or a path) is missing, too large, or no mesh.
    """
    vertices = _read_mesh(shape.element.get("filename", ""), folders)
    scaled = vertices * numbers(shape.element.get("scale", "1 1 1"), 3)
    return np.asarray(shape.centre + scaled @ shape.rotation.T)


def _vertices(path: Path) -> FloatArray:
    import coal

    try:
        return np.array(coal.MeshLoader().load(str(path), np.ones(3)).vertices(), dtype=np.float64)
    except Exception as error:  # Coal and its mesh readers raise several kinds, none of them public
        raise UsageError(f"not a mesh: {path}") from error


def _read_mesh(filename: str, folders: Sequence[Path]) -> FloatArray:
    plain = filename.removeprefix("file://")
    within = filename.removeprefix("package://")
    try:
        # Where the package's own folder is searched, its name is not part of the path any more.
        inside = [within, within.partition("/")[2]] if filename.startswith("package://") else [plain]
        candidates = [folder / path for folder in folders for path in inside if path]
        candidates += [Path(plain)] if Path(plain).is_absolute() else []
        path = next((candidate for candidate in candidates if candidate.is_file()), None)
    except (OSError, ValueError) as error:  # a name too long, or a NUL in it
        raise UnusableShapeError(f"no such file: {filename}") from error
    if path is None:
        raise UnusableShapeError(f"no such file: {filename}")
    try:
        check_input(path, MESH_FILE, UsageError)
        vertices = read_apart(lambda progress: _vertices(path), path, UsageError, time_limit=_MESH_TIME)
    except UsageError as error:
        raise UnusableShapeError(str(error)) from error
    if vertices.ndim != 2 or vertices.shape[1] != 3 or len(vertices) == 0 or not np.all(np.isfinite(vertices)):
        raise UnusableShapeError(f"no points in {path}")
    return vertices
