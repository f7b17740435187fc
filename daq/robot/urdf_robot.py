"""An arm's joints, limits and tool from a URDF, read without a kinematics library."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import PurePath

import numpy as np
import yaml

from daq.robot.urdf_check import checked_urdf
from drivers.core.arrays import FloatArray
from drivers.core.errors import RobotFileError

MOVABLE = ("revolute", "continuous", "prismatic")
UNLIMITED = 2 * math.pi
"""Position limit of a continuous joint [rad]: a turn to either side."""
TOOL_LINKS = ("tool0", "tcp", "tool", "flange", "ee")
"""Words in the names of links that a tool is mounted on, the most telling first (ROS-Industrial, REP 199: `tool0`)."""
GRIPPER_WORDS = ("finger", "gripper", "hand", "jaw", "knuckle", "thumb", "claw")
"""Words in the names of joints that open and close a gripper."""
RIGHT_ANGLE_RESIDUE = 1e-9
"""Rounding residue of sines and cosines of right angles [m or rad]."""


@dataclass(frozen=True)
class UrdfJoint:
    """A movable joint; limits that the URDF does not state, or states as 0, are None."""

    name: str  # of the joint
    kind: str  # revolute, continuous or prismatic
    # lower and upper limit [rad or m]; of a continuous joint one turn to either side
    position: tuple[float, float] | None
    velocity: float | None  # [rad/s or m/s]
    torque: float | None  # [N·m or N]


@dataclass(frozen=True)
class Mimic:
    """A joint that follows another one: position = offset + multiplier · position of `follows`."""

    name: str  # of the joint
    follows: str  # name of a joint that moves by itself
    multiplier: float  # of its position; rad/rad, m/rad, … as the joints are
    offset: float  # [rad or m]


@dataclass(frozen=True)
class UrdfArm:
    """The joints of a URDF and where its tool is mounted."""

    name: str  # of the robot
    joints: tuple[UrdfJoint, ...]  # those that move by themselves, parents before children
    # those that follow another joint (`<mimic>`: a gripper's second finger, a parallelogram's rod)
    mimics: tuple[Mimic, ...]
    tool_link: str  # name of the link at which the arm ends
    tool: tuple[float, ...]  # (3,) its origin [m] in the frame of the last joint
    tool_rotation: tuple[float, ...]  # (3,) its axes there, as a rotation vector [rad]
    locked: tuple[tuple[str, float], ...] = ()  # joints that do not move, and their position [rad or m]


def urdf_prismatic_joints(xml: str) -> frozenset[str]:
    """Names of the joints that slide; empty for invalid XML, which is reported where the model is built."""
    try:
        root = ElementTree.fromstring(xml)
    except ElementTree.ParseError:
        return frozenset()
    return frozenset(joint.get("name", "") for joint in root.iter("joint") if joint.get("type") == "prismatic")


def read_urdf_arm(xml: str, file_name: str, where: str, *, one_arm: bool = False) -> UrdfArm:
    """The joints of a URDF.

    Args:
        xml: the URDF.
        file_name: names the robot where the URDF doesn't.
        where: the file, for messages.
        one_arm: whether the joints beside the longest chain, and a gripper's at its end, are locked.

    Raises:
        RobotFileError: no URDF, no movable joint, something in it that is not a sensible number, or a `<mimic>` that
            follows no joint.
    """
    root = checked_urdf(xml, where)
    joints = _parents_first([joint for joint in root.findall("joint") if joint.find("child") is not None])
    movable = [joint for joint in joints if joint.get("type") in MOVABLE]
    mimicking = [joint for joint in movable if joint.find("mimic") is not None]
    driven = [joint for joint in movable if joint.find("mimic") is None]
    if not driven:
        raise RobotFileError("has no movable joint", where=where)
    kept = _longest_chain(driven, joints) if one_arm else driven
    positions = {
        joint.get("name", ""): _still(_joint(joint, where))
        for joint in driven
        if all(joint is not link for link in kept)
    }
    mimics = _mimics(mimicking, {joint.get("name", "") for joint in driven}, where)
    for mimic in mimics:
        if mimic.follows in positions:
            positions[mimic.name] = mimic.offset + mimic.multiplier * positions[mimic.follows]
    tool_link, tool, tool_rotation = _tool(link_of(kept[-1], "child"), joints, where)
    return UrdfArm(
        name=root.get("name") or PurePath(file_name).stem,
        joints=tuple(_joint(joint, where) for joint in kept),
        mimics=tuple(mimic for mimic in mimics if mimic.name not in positions),
        tool_link=tool_link,
        tool=tool,
        tool_rotation=tool_rotation,
        locked=tuple(positions.items()),
    )


def _parents_first(joints: list[ElementTree.Element]) -> list[ElementTree.Element]:
    by_child = {link_of(joint, "child"): joint for joint in joints}

    def depth(joint: ElementTree.Element) -> int:
        steps, parent = 0, by_child.get(link_of(joint, "parent"))
        while parent is not None and steps <= len(joints):
            steps, parent = steps + 1, by_child.get(link_of(parent, "parent"))
        return steps

    return sorted(joints, key=depth)


def _longest_chain(driven: list[ElementTree.Element], joints: list[ElementTree.Element]) -> list[ElementTree.Element]:
    """The most joints that carry each other, without those of a gripper at the end."""
    by_child = {link_of(joint, "child"): joint for joint in joints}
    longest: list[ElementTree.Element] = []
    for last in driven:
        chain, joint = [last], by_child.get(link_of(last, "parent"))
        for _ in joints:
            if joint is None:
                break
            chain += [link_joint for link_joint in driven if link_joint is joint]
            joint = by_child.get(link_of(joint, "parent"))
        if len(chain) > len(longest):
            longest = chain[::-1]
    arm = list(longest)
    while arm and any(word in arm[-1].get("name", "").lower() for word in GRIPPER_WORDS):
        arm.pop()
    return arm or longest


def _still(joint: UrdfJoint) -> float:
    """Position at which a joint is locked [rad or m]: the one nearest to 0 within its limits."""
    low, high = joint.position or (0.0, 0.0)
    return min(max(0.0, low), high) if low <= high else 0.0


def robot_text_of_urdf(arm: UrdfArm, file_name: str, where: str) -> str:
    """The text of a robot file for a URDF: its movable joints, parents before children, with their limits.

    Raises:
        RobotFileError: a joint without a position or velocity limit; its `problems` are all of them.
    """
    problems = tuple(
        RobotFileError(
            f"states no {' and no '.join(missing)} limit",
            where=f"{where}: joint {joint.name}",
            hint="complete its <limit>, or write a robot file: dynid robot new ARM.urdf -o ARM.yaml",
        )
        for joint in arm.joints
        if (missing := [key for key in ("position", "velocity") if getattr(joint, key) is None])
    )
    if problems:
        problems[0].problems = problems
        raise problems[0]
    model: dict[str, object] = {"urdf": file_name}
    if arm.mimics:
        model["loops"] = [
            {"joint": mimic.name, "equation": {mimic.follows: mimic.multiplier}, "offset": mimic.offset}
            for mimic in arm.mimics
        ]
    content = {
        "name": arm.name,
        "model": model,
        "joints": [_limits(joint) for joint in arm.joints],
        "workspace": {"tool": list(arm.tool), "tool_rotation": list(arm.tool_rotation)},
    }
    return yaml.safe_dump(content, allow_unicode=True, sort_keys=False)


def assumed_of_urdf(arm: UrdfArm) -> tuple[str, ...]:
    """The assumptions of `robot_text_of_urdf` in place of what the URDF does not state, in words."""
    continuous = [joint.name for joint in arm.joints if joint.kind == "continuous"]
    assumed = [f"the tool is at the origin of the URDF's link {arm.tool_link}"]
    if continuous:
        assumed.append(f"position limits -2π to 2π of the continuous joints ({', '.join(continuous)})")
    return tuple(assumed)


def _mimics(joints: list[ElementTree.Element], driven: set[str], where: str) -> tuple[Mimic, ...]:
    """Return what each of the joints follows, through others that follow too."""
    stated = {}
    for joint in joints:
        mimic = joint.find("mimic")
        assert mimic is not None
        values = float(mimic.get("multiplier", "1")), float(mimic.get("offset", "0"))
        stated[joint.get("name", "")] = (mimic.get("joint", ""), *values)
    mimics = []
    for name in stated:
        follows, multiplier, offset, passed = *stated[name], {name}
        while follows in stated and follows not in passed:
            passed.add(follows)
            follows, next_multiplier, next_offset = stated[follows]
            multiplier, offset = multiplier * next_multiplier, offset + multiplier * next_offset
        if follows not in driven:
            raise RobotFileError(
                f"follows '{follows}' (<mimic>), which is not a joint that moves by itself",
                where=f"{where}: joint {name}",
                hint="name a movable joint there, or make this one fixed",
            )
        mimics.append(Mimic(name, follows, multiplier, offset))
    return tuple(mimics)


def link_of(joint: ElementTree.Element, end: str) -> str:
    """Name of the link at the `parent` or `child` end of a joint; empty where there is none."""
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def _joint(joint: ElementTree.Element, where: str) -> UrdfJoint:
    limit = joint.find("limit")
    stated = {} if limit is None else limit.attrib
    name, kind = joint.get("name", ""), joint.get("type", "")
    try:
        values = {key: float(stated[key]) for key in ("lower", "upper", "velocity", "effort") if key in stated}
    except ValueError as error:
        raise RobotFileError("has a limit that is not a number", where=f"{where}: joint {name}") from error
    if not all(math.isfinite(value) for value in values.values()):
        raise RobotFileError("has a limit that is not finite", where=f"{where}: joint {name}")
    position = (values["lower"], values["upper"]) if {"lower", "upper"} <= values.keys() else None
    if kind == "continuous":
        position = (-UNLIMITED, UNLIMITED)
    return UrdfJoint(
        name=name,
        kind=kind,
        position=None if position == (0.0, 0.0) else position,  # written by exporters that do not know the limits
        velocity=value if (value := values.get("velocity", 0.0)) > 0 else None,
        torque=value if (value := values.get("effort", 0.0)) > 0 else None,
    )


def _limits(joint: UrdfJoint) -> dict[str, object]:
    limits: dict[str, object] = {"name": joint.name, "position": list(joint.position or ()), "velocity": joint.velocity}
    if joint.torque is not None:
        limits["torque"] = joint.torque
    return limits


def _tool(last: str, joints: list[ElementTree.Element], where: str) -> tuple[str, tuple[float, ...], tuple[float, ...]]:
    """Find the link at which the arm ends, fixed to the last one: name, origin [m], rotation vector [rad]."""
    from scipy.spatial.transform import Rotation

    placed = {last: (Rotation.identity(), np.zeros(3))}
    waiting = [last]
    while waiting:
        parent = waiting.pop()
        for joint in joints:
            child = link_of(joint, "child")
            if joint.get("type") == "fixed" and link_of(joint, "parent") == parent and child not in placed:
                xyz, rpy = origin_of(joint, where)
                rotation, origin = placed[parent]
                placed[child] = rotation * Rotation.from_euler("xyz", rpy), origin + rotation.apply(xyz)
                waiting.append(child)
    named = [link for word in TOOL_LINKS for link in placed if word in link.lower().split("_")]
    link = named[0] if named else last
    rotation, origin = placed[link]
    return link, _exact(origin), _exact(rotation.as_rotvec())


def origin_of(joint: ElementTree.Element, where: str) -> tuple[FloatArray, FloatArray]:
    """A joint's origin in its parent link: xyz [m] and rpy [rad]."""
    origin = joint.find("origin")
    stated = {} if origin is None else origin.attrib
    place = f"{where}: joint {joint.get('name')}"
    try:
        xyz, rpy = (np.array([float(text) for text in stated.get(key, "0 0 0").split()]) for key in ("xyz", "rpy"))
    except ValueError as error:
        raise RobotFileError("has an origin that is not a number", where=place) from error
    if not (xyz.shape == rpy.shape == (3,) and np.isfinite([xyz, rpy]).all()):
        raise RobotFileError("has an origin that is not three numbers", where=place)
    return xyz, rpy


def _exact(values: FloatArray) -> tuple[float, ...]:
    return tuple(0.0 if abs(value) < RIGHT_ANGLE_RESIDUE else float(value) for value in values)
