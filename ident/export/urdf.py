"""A URDF with the identified bodies, friction and limits: complete, or the robot's own with these replaced."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np

from drivers.core.arrays import FloatArray
from ident.export.arm import ExportedArm, Segment, link_segments
from ident.export.left_out import left_out_of_urdf
from ident.export.xml_text import comment_text, number, numbers, roll_pitch_yaw
from ident.model.kinematics.joints import BASE_INDEX

BASE_LINK = "base_link"
NO_EFFORT_LIMIT = 1e6
"""[N·m or N] where no torque limit is known: the format demands a number, and 0 would hold the joint back."""

PASSIVE_TRIALS = 200
"""Positions of the motors at which the range of a sliding joint that follows is looked for."""


def notes(arm: ExportedArm) -> list[str]:
    """Lines of the comment at the head of the file."""
    return [
        f"Dynamic model of {arm.model.name}, identified with dynid. Inertials are physically consistent; the bodies of",
        "single links are one choice among those with the same torques. Not in this file:",
        *(f"- {sentence}" for sentence in left_out_of_urdf(arm)),
    ]


def new_urdf(arm: ExportedArm) -> str:
    """The text of a complete URDF, link frames as the robot file has them; links are named after their joints."""
    model = arm.model
    root = ElementTree.Element("robot", name=model.name)
    root.append(ElementTree.Comment("\n" + comment_text(notes(arm))))
    segments = link_segments(arm)
    _link(root, BASE_LINK, segments.get(BASE_INDEX, []))
    ranges = _passive_ranges(arm)
    for index, joint in enumerate(model.joints):
        link = _link(root, link_name(joint.name), segments.get(index, []))
        link.insert(0, inertial(arm, index))
        kind = "prismatic" if joint.prismatic else "revolute" if index in model.active else "continuous"
        element = ElementTree.SubElement(root, "joint", name=joint.name, type=kind)
        _origin(element, joint.translation, joint.rotation)
        parent = BASE_LINK if joint.parent == BASE_INDEX else link_name(model.joints[joint.parent].name)
        ElementTree.SubElement(element, "parent", link=parent)
        ElementTree.SubElement(element, "child", link=link_name(joint.name))
        ElementTree.SubElement(element, "axis", xyz=numbers(joint.axis))
        if index in model.active:
            ElementTree.SubElement(element, "limit", limit_attributes(arm, index))
            ElementTree.SubElement(element, "dynamics", dynamics_attributes(arm, index))
        elif joint.prismatic:
            low, high = ranges[index]
            ElementTree.SubElement(
                element, "limit", lower=number(low), upper=number(high), effort="0", velocity=number(1e3)
            )
    ElementTree.indent(root)
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def link_name(joint: str) -> str:
    """Name of the link behind a joint, where there is no URDF that names it."""
    return f"{joint}_link"


def inertial(arm: ExportedArm, index: int) -> ElementTree.Element:
    """The element `inertial` of a link."""
    body = arm.bodies[index]
    element = ElementTree.Element("inertial")
    ElementTree.SubElement(element, "origin", xyz=numbers(body.com), rpy="0 0 0")
    ElementTree.SubElement(element, "mass", value=number(body.mass))
    tensor = {f"i{name}": number(value) for name, value in body.inertia.items()}
    ElementTree.SubElement(element, "inertia", tensor)
    return element


def limit_attributes(arm: ExportedArm, index: int) -> dict[str, str]:
    """Limits of a joint with a motor, from the robot file; `NO_EFFORT_LIMIT` where the torque limit is not known."""
    limits = arm.model.limits[arm.model.active.index(index)]
    low, high = limits.position
    attributes = {"lower": number(low), "upper": number(high), "velocity": number(limits.velocity)}
    return {**attributes, "effort": number(NO_EFFORT_LIMIT if limits.torque is None else limits.torque)}


def dynamics_attributes(arm: ExportedArm, index: int) -> dict[str, str]:
    """Damping and friction of a joint with a motor."""
    motor, terms = arm.model.active.index(index), arm.at_joints
    return {"damping": number(terms.viscous[motor]), "friction": number(terms.coulomb[motor])}


def _link(root: ElementTree.Element, name: str, segments: list[Segment]) -> ElementTree.Element:
    link = ElementTree.SubElement(root, "link", name=name)
    for start, end, radius in segments:
        visual = ElementTree.SubElement(link, "visual")
        _origin(visual, 0.5 * (start + end), _along(end - start))
        geometry = ElementTree.SubElement(visual, "geometry")
        length = float(np.linalg.norm(end - start))
        if length > 0:
            ElementTree.SubElement(geometry, "cylinder", radius=number(radius), length=number(length))
        else:
            ElementTree.SubElement(geometry, "sphere", radius=number(radius))
    return link


def _origin(element: ElementTree.Element, translation: FloatArray, rotation: FloatArray) -> None:
    ElementTree.SubElement(element, "origin", xyz=numbers(translation), rpy=numbers(roll_pitch_yaw(rotation)))


def _along(direction: FloatArray) -> FloatArray:
    """A rotation (3, 3) whose z axis has this direction."""
    length = float(np.linalg.norm(direction))
    if length == 0.0:
        return np.eye(3)
    z = direction / length
    x = np.cross(np.eye(3)[int(np.argmin(np.abs(z)))], z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def _passive_ranges(arm: ExportedArm) -> dict[int, tuple[float, float]]:
    """Positions that the joints without a motor reach, by their number."""
    model = arm.model
    if not arm.closed:
        return {}
    low, high = (np.array(limit) for limit in zip(*(limits.position for limits in model.limits), strict=True))
    trials = np.random.default_rng(0).uniform(low[:, None], high[:, None], (model.dof, PASSIVE_TRIALS))
    tree = model.tree_position(trials)
    margin = 0.05 * np.ptp(tree, axis=1)
    return {
        index: (float(tree[index].min() - margin[index]), float(tree[index].max() + margin[index]))
        for index in range(len(model.joints))
        if index not in model.active
    }
