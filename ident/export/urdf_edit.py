"""A robot's own URDF with new inertials, friction and limits; meshes, comments, transmissions and all else stay.

Edited as a DOM tree, since ElementTree loses what stands before the root and renames namespaces.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING
from xml.dom import minidom
from xml.etree import ElementTree
from xml.parsers.expat import ExpatError

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import RobotFileError
from ident.export.arm import ExportedArm
from ident.export.urdf import dynamics_attributes, inertial, limit_attributes, notes
from ident.export.xml_text import comment_text, numbers, roll_pitch_yaw
from ident.linear_algebra.vectors import axis_rotation, rotation_of
from ident.model.kinematics.urdf import RIGHT_ANGLE_TOLERANCE, urdf_joints

if TYPE_CHECKING:
    from xml.dom.minidom import Document, Element

FRAME_TOLERANCE = 1e-6
"""How far [m, rad] the frames of another URDF may lie from those that were identified."""

VISIBLE = 1e-9
"""[rad] from which on a rounded right angle is worth a word."""


def edited_urdf(arm: ExportedArm, xml: str, where: str) -> str:
    """The text of a URDF with the arm's bodies, friction and limits in it.

    Bodies that are fixed to a moved link, also through locked joints, are part of that link's: their inertials are
    removed, and locked joints become fixed where they were locked.

    Raises:
        RobotFileError: it is no URDF, its joints are not those of the arm, or they lie elsewhere.
    """
    check_joints(arm, xml, where)
    try:
        document = minidom.parseString(xml.encode("utf-8"))
    except (ExpatError, ValueError) as error:
        raise RobotFileError(f"not a URDF: {error}", where=where) from error
    root = document.documentElement
    if root is None:
        raise RobotFileError("not a URDF: no robot in it", where=where)
    joints = {element.getAttribute("name"): element for element in _children(root, "joint") if _child_link(element)}
    links = {element.getAttribute("name"): element for element in _children(root, "link")}
    locked = arm.robot_file.robot.model.locked
    names = arm.model.link_names
    for index, name in enumerate(names):
        joint, link = joints[name], links[_child_link(joints[name])]
        _replace(document, link, "inertial", inertial(arm, index))
        if index in arm.model.active:
            _set_attributes(document, joint, "limit", _limits(joint, arm, index))
            _set_attributes(document, joint, "dynamics", dynamics_attributes(arm, index))
    carriers = {_child_link(joints[name]) for name in names}
    moved = _moved_links(joints, carriers)
    for name in moved - carriers:
        if name in links:
            _remove(links[name], "inertial")
    for name, position in locked.items():
        _fix(document, joints[name], position)
    exact = _exact_right_angles(arm, joints, carriers)
    lines = notes(arm)
    if locked:
        lines.append(f"Fixed where they were locked: {', '.join(f'{n} at {p:g}' for n, p in locked.items())}.")
    if exact:
        lines.append(f"Right angles that were rounded are written in full, as identified: {', '.join(exact)}.")
    root.insertBefore(document.createTextNode("\n  "), root.firstChild)
    comment = document.createComment("\n" + comment_text([f"    {line}" for line in lines]) + "  ")
    root.insertBefore(comment, root.firstChild)
    root.insertBefore(document.createTextNode("\n  "), comment)
    return "\n".join(['<?xml version="1.0"?>', *(node.toxml() for node in document.childNodes)]) + "\n"


def check_joints(arm: ExportedArm, xml: str, where: str) -> None:
    """Refuse a URDF that is not the one that was identified, in its joints and where they lie.

    Raises:
        RobotFileError: naming the joint.
    """
    model = arm.model
    joints = urdf_joints(xml, model.link_names, arm.robot_file.robot.model.locked, where)
    for mine, other in zip(model.joints, joints, strict=True):
        if mine.parent != other.parent:
            raise RobotFileError(
                f"joint '{mine.name}' is attached to another link than in the identified arm", where=where
            )
        if mine.prismatic != other.prismatic:
            raise RobotFileError(f"joint '{mine.name}' slides in one and turns in the other", where=where)
        apart = float(np.linalg.norm(mine.translation - other.translation))
        turn = float(np.linalg.norm(mine.rotation - other.rotation)) / math.sqrt(2.0)
        axis = float(np.linalg.norm(mine.axis - other.axis))
        if max(apart, turn, axis) > FRAME_TOLERANCE:
            raise RobotFileError(
                f"the frame of joint '{mine.name}' is not the identified arm's: {1e3 * apart:.4g} mm apart, turned by "
                f"{math.degrees(max(turn, axis)):.3g}°",
                where=where,
                hint="bodies are known in the identified frames only: identify with this URDF as the robot's model",
            )


def _limits(joint: Element, arm: ExportedArm, index: int) -> dict[str, str]:
    """New limits; a torque limit that the robot file does not know stays, and a continuous joint gets no positions."""
    attributes = limit_attributes(arm, index)
    own = next(iter(_children(joint, "limit")), None)
    if (
        arm.model.limits[arm.model.active.index(index)].torque is None
        and own is not None
        and own.hasAttribute("effort")
    ):
        attributes["effort"] = own.getAttribute("effort")
    if joint.getAttribute("type") == "continuous":
        del attributes["lower"], attributes["upper"]
    return attributes


def _moved_links(joints: Mapping[str, Element], carriers: set[str]) -> set[str]:
    """Names of the links behind the arm's joints."""
    parent_of = {_child_link(joint): _end(joint, "parent") for joint in joints.values()}
    moved = set()
    for link in parent_of:
        above: str | None = link
        for _ in range(len(parent_of) + 1):
            if above is None or above in carriers:
                break
            above = parent_of.get(above)
        if above in carriers:
            moved.add(link)
    return moved


def _fix(document: Document, joint: Element, position: float) -> None:
    """Make a locked joint a fixed one, at its position [rad or m]."""
    translation, rotation = np.array(_origin(joint, "xyz")), rotation_of(*_origin(joint, "rpy"))
    axis = next(iter(_children(joint, "axis")), None)
    words = (axis.getAttribute("xyz") if axis is not None else "") or "1 0 0"
    direction = np.array([float(word) for word in words.split()])
    direction /= np.linalg.norm(direction)
    if joint.getAttribute("type") == "prismatic":
        translation = translation + rotation @ direction * position
    else:
        rotation = rotation @ axis_rotation(direction, position)
    if position:
        origin = {"xyz": numbers(translation), "rpy": numbers(roll_pitch_yaw(rotation))}
        _set_attributes(document, joint, "origin", origin)
    joint.setAttribute("type", "fixed")
    for tag in ("axis", "limit", "dynamics", "mimic", "calibration", "safety_controller"):
        _remove(joint, tag)


def _exact_right_angles(arm: ExportedArm, joints: Mapping[str, Element], carriers: set[str]) -> list[str]:
    """Write angles such as 1.5708 in full where the identification took them as right angles; names of the joints."""
    by_child = {_child_link(joint): joint for joint in joints.values()}
    changed = []
    for model_joint in arm.model.joints:
        chain = [joints[model_joint.name]]
        while (parent := _end(chain[-1], "parent")) not in carriers and parent in by_child:
            chain.append(by_child[parent])
        angles = [_origin(joint, "rpy") for joint in chain]
        exact = [_exact(angle) for angle in angles]
        if _distance(exact, model_joint.rotation) >= _distance(angles, model_joint.rotation):
            continue
        for joint, rounded, full in zip(chain, angles, exact, strict=True):
            if rounded != full:
                next(iter(_children(joint, "origin"))).setAttribute("rpy", numbers(full))
            if max(abs(written - other) for written, other in zip(rounded, full, strict=True)) > VISIBLE:
                changed.append(joint.getAttribute("name"))
    return changed


def _exact(angles: Sequence[float]) -> list[float]:
    """The angles [rad], those next to a multiple of π/2 replaced by it."""
    nearest = [0.5 * math.pi * round(angle / (0.5 * math.pi)) for angle in angles]
    return [n if abs(a - n) < RIGHT_ANGLE_TOLERANCE else a for a, n in zip(angles, nearest, strict=True)]


def _distance(chain: Sequence[Sequence[float]], rotation: FloatArray) -> float:
    """Largest difference of a rotation from that of a chain of joints, the last one first, by their angles [rad]."""
    total = np.eye(3)
    for angles in chain:
        total = rotation_of(*angles) @ total
    return float(np.abs(total - rotation).max())


def _origin(joint: Element, key: str) -> list[float]:
    origin = next(iter(_children(joint, "origin")), None)
    text = (origin.getAttribute(key) if origin is not None else "") or "0 0 0"
    return [float(word) for word in text.split()]


def _children(element: Element, tag: str) -> list[Element]:
    return [child for child in element.childNodes if child.nodeType == child.ELEMENT_NODE and child.tagName == tag]


def _end(joint: Element, tag: str) -> str:
    end = next(iter(_children(joint, tag)), None)
    return "" if end is None else end.getAttribute("link")


def _child_link(joint: Element) -> str:
    return _end(joint, "child")


def _remove(element: Element, tag: str) -> None:
    for child in _children(element, tag):
        before = child.previousSibling
        if before is not None and before.nodeType == before.TEXT_NODE and not before.data.strip():
            element.removeChild(before)
        element.removeChild(child)


def _replace(document: Document, element: Element, tag: str, content: ElementTree.Element) -> None:
    """Put an element in the place of the first with its tag, or last; written one level below its parent."""
    indent = "\n" + "  " * 2
    ElementTree.indent(content, level=2)
    parsed = minidom.parseString(ElementTree.tostring(content)).documentElement
    if parsed is None:
        raise ValueError("an element without content")
    new = document.importNode(parsed, deep=True)
    old = _children(element, tag)
    if old:
        element.replaceChild(new, old[0])
        for other in old[1:]:
            element.removeChild(other)
        return
    last = element.lastChild
    if last is None or last.nodeType != last.TEXT_NODE:
        last = element.appendChild(document.createTextNode("\n  "))
    element.insertBefore(document.createTextNode(indent), last)
    element.insertBefore(new, last)


def _set_attributes(document: Document, element: Element, tag: str, attributes: Mapping[str, str]) -> None:
    child = next(iter(_children(element, tag)), None)
    if child is None:
        _replace(document, element, tag, ElementTree.Element(tag, dict(attributes)))
        return
    for name, value in attributes.items():
        child.setAttribute(name, value)
