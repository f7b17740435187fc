"""Four lengths that tell a six-axis arm from another model of its kind, wherever a robot file puts its frames."""

from __future__ import annotations

from contextlib import suppress
from xml.etree import ElementTree

import numpy as np

from daq.robot.loader import RobotFile
from daq.robot.loops import BASE
from daq.robot.schema import MdhRow
from daq.robot.urdf_robot import link_of, origin_of
from drivers.core.arrays import FloatArray

AXES = 6
Axis = tuple[FloatArray, FloatArray, str]
"""A point on an axis and its direction, (3,) each, in the base frame with all joints at 0; the joint before it, or
none."""


def arm_lengths(robot_file: RobotFile) -> FloatArray | None:
    """Upper arm, forearm, shoulder offset and wrist offset (4,) [m]; None of an arm that has not six revolute axes.

    The distance of axes 2 and 3, that of axes 3 and 4, the way along axis 2 from axis 1 to axis 5, and the way along
    axis 5 from axis 4 to axis 6: |a2|, |a3|, |d2 + d3 + d4| and |d5| of Denavit-Hartenberg parameters.

    Raises:
        RobotFileError: the URDF has an origin that is not a number.
    """
    robot = robot_file.robot
    if len(robot.joints) != AXES or any(joint.sliding for joint in robot.joints):
        return None
    axes = joint_axes(robot_file)
    if not set(robot.joint_names) <= axes.keys():
        return None
    points, directions, _ = zip(*(axes[name] for name in robot.joint_names), strict=True)
    between = [points[later] - points[earlier] for earlier, later in ((1, 2), (2, 3), (0, 4), (3, 5))]
    return np.array(
        [
            np.linalg.norm(np.cross(between[0], directions[1])),
            np.linalg.norm(np.cross(between[1], directions[2])),
            abs(between[2] @ directions[1]),
            abs(between[3] @ directions[4]),
        ]
    )


def joint_axes(robot_file: RobotFile) -> dict[str, Axis]:
    """The axis of every joint of a robot file's table or URDF, by its name.

    Raises:
        RobotFileError: the URDF has an origin that is not a number.
    """
    rows, xml = robot_file.robot.model.mdh, robot_file.urdf_text
    return _of_rows(rows) if rows is not None else _of_urdf(xml, robot_file.where) if xml is not None else {}


def _of_rows(rows: tuple[MdhRow, ...]) -> dict[str, Axis]:
    frames = {BASE: np.eye(4)}
    for row in rows:
        frames[row.joint] = (
            frames[row.antecedent]
            @ _screw(2, row.gamma, row.b)
            @ _screw(0, row.alpha, row.d)
            @ _screw(2, row.theta0, row.r)
        )
    return {row.joint: (frames[row.joint][:3, 3], frames[row.joint][:3, 2], row.antecedent) for row in rows}


def _screw(axis: int, angle: float, way: float) -> FloatArray:
    """A turn about a coordinate axis and a way along it."""
    first, second = (axis + 1) % 3, (axis + 2) % 3
    frame = np.eye(4)
    frame[first, first] = frame[second, second] = np.cos(angle)
    frame[second, first] = np.sin(angle)
    frame[first, second] = -frame[second, first]
    frame[axis, 3] = way
    return frame


def _of_urdf(xml: str, where: str) -> dict[str, Axis]:
    from scipy.spatial.transform import Rotation

    joints = {link_of(joint, "child"): joint for joint in ElementTree.fromstring(xml).findall("joint")}
    frames: dict[str, FloatArray] = {}

    def frame(link: str, depth: int = 0) -> FloatArray:
        joint = joints.get(link)
        if joint is None or depth > len(joints):
            return np.eye(4)
        if link not in frames:
            xyz, rpy = origin_of(joint, where)
            own = np.eye(4)
            own[:3, :3], own[:3, 3] = Rotation.from_euler("xyz", rpy).as_matrix(), xyz
            frames[link] = frame(link_of(joint, "parent"), depth + 1) @ own
        return frames[link]

    axes: dict[str, Axis] = {}
    for link, joint in joints.items():
        before = joints.get(link_of(joint, "parent"))
        stated = joint.find("axis")
        with suppress(ValueError):  # an axis that is no number
            axis = np.array(
                [float(text) for text in ("1 0 0" if stated is None else stated.get("xyz", "1 0 0")).split()]
            )
            if axis.shape == (3,) and (size := float(np.linalg.norm(axis))) > 0.0:
                parent = "" if before is None else before.get("name", "")
                axes[joint.get("name", "")] = (frame(link)[:3, 3], frame(link)[:3, :3] @ axis / size, parent)
    return axes
