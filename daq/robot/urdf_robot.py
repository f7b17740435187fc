"""What a URDF says of its joints, read without a kinematics library."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from pathlib import PurePath

import yaml

from drivers.errors import RobotFileError

MOVABLE = ("revolute", "continuous", "prismatic")
UNLIMITED = 2 * math.pi
"""Position limit of a continuous joint [rad]: a turn to either side."""


def urdf_prismatic_joints(xml: str) -> frozenset[str]:
    """Names of the joints that slide; empty for what is no XML, which is reported where the model is built."""
    try:
        root = ElementTree.fromstring(xml)
    except ElementTree.ParseError:
        return frozenset()
    return frozenset(joint.get("name", "") for joint in root.iter("joint") if joint.get("type") == "prismatic")


def robot_text_of_urdf(xml: str, file_name: str, where: str) -> str:
    """The text of a robot file for a URDF: its movable joints, parents before children, with their limits.

    Raises:
        RobotFileError: no XML, no movable joint, or a joint without limits.
    """
    try:
        root = ElementTree.fromstring(xml)
    except ElementTree.ParseError as error:
        raise RobotFileError(f"is not a URDF: {error}", where=where) from error
    joints = [joint for joint in root.findall("joint") if joint.find("child") is not None]
    by_child = {_link(joint, "child"): joint for joint in joints}

    def depth(joint: ElementTree.Element) -> int:
        steps, parent = 0, by_child.get(_link(joint, "parent"))
        while parent is not None and steps <= len(joints):
            steps, parent = steps + 1, by_child.get(_link(parent, "parent"))
        return steps

    movable = [joint for joint in sorted(joints, key=depth) if joint.get("type") in MOVABLE]
    if not movable:
        raise RobotFileError("has no movable joint", where=where)
    content = {
        "name": root.get("name") or PurePath(file_name).stem,
        "model": {"urdf": file_name},
        "joints": [_limits(joint, where) for joint in movable],
    }
    return yaml.safe_dump(content, allow_unicode=True, sort_keys=False)


def _link(joint: ElementTree.Element, end: str) -> str:
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def _limits(joint: ElementTree.Element, where: str) -> dict[str, object]:
    name, limit = joint.get("name", ""), joint.find("limit")
    stated = {} if limit is None else limit.attrib
    try:
        values = {key: float(stated[key]) for key in ("lower", "upper", "velocity", "effort") if key in stated}
    except ValueError as error:
        raise RobotFileError("has a limit that is not a number", where=f"{where}: joint {name}") from error
    if joint.get("type") == "continuous":
        values |= {"lower": -UNLIMITED, "upper": UNLIMITED}
    missing = [key for key in ("lower", "upper", "velocity") if key not in values]
    if missing:
        raise RobotFileError(
            f"states no {' and '.join(missing)} limit",
            where=f"{where}: joint {name}",
            hint="complete <limit lower= upper= velocity= effort=>, or write a robot file",
        )
    limits: dict[str, object] = {"name": name, "position": [values["lower"], values["upper"]]}
    limits["velocity"] = values["velocity"]
    if values.get("effort", 0.0) > 0:
        limits["torque"] = values["effort"]
    return limits
