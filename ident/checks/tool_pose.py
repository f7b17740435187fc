"""Poses of the tool at named joint positions, to compare with what the teach pendant shows."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from daq.robot.loader import RobotFile
from ident.excite.constraints.placements import place_arm, tool_point
from ident.model.dynamic_model import DynamicModel

ZERO = "zero"
"""Name of the pose at which every joint is at 0."""
SHOWN_AS_ZERO = 1e-12
"""[m or rad] below which a number is rounding residue and shown as 0."""


@dataclass(frozen=True)
class ToolPose:
    """The tool's place in the base frame at one position of the joints; UR's pendant shows the rotation vector."""

    name: str  # of the pose
    joints: tuple[float, ...]  # (n,) positions [rad or m]
    position: tuple[float, ...]  # (3,) of the tool point [m]
    rotation_vector: tuple[float, ...]  # (3,) of the tool's axes [rad]
    rpy: tuple[float, ...]  # (3,) the same as roll, pitch, yaw [rad] about the base frame's x, y, z, in this order
    beyond: tuple[str, ...]  # names of the joints that are outside their limits there


def tool_poses(robot_file: RobotFile, model: DynamicModel) -> tuple[ToolPose, ...]:
    """The tool's pose at position zero and at the file's `poses`.

    The tool point is `workspace.tool`, its axes are the last joint's turned by `workspace.tool_rotation`. Where loops
    follow by closing, a pose beyond the limits is meaningless: the loops need not close there.
    """
    zero = {ZERO: (0.0,) * robot_file.robot.dof}
    return tuple(
        _tool_pose(robot_file, model, name, joints) for name, joints in (zero | robot_file.robot.poses).items()
    )


def _tool_pose(robot_file: RobotFile, model: DynamicModel, name: str, joints: tuple[float, ...]) -> ToolPose:
    from scipy.spatial.transform import Rotation

    workspace = robot_file.robot.workspace
    placements = place_arm(model, np.array(joints)[:, None])
    turned = Rotation.from_matrix(placements.rotation[model.tool_link, :, :, 0])
    rotation = turned * Rotation.from_rotvec(workspace.tool_rotation)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pitch of ±π/2: SciPy then calls all of the turn about z yaw, which is right
        rpy = rotation.as_euler("xyz")
    return ToolPose(
        name=name,
        joints=joints,
        position=_numbers(tool_point(model, placements, workspace.tool)[:, 0]),
        rotation_vector=_numbers(rotation.as_rotvec()),
        rpy=_numbers(rpy),
        beyond=tuple(
            limits.name
            for limits, value in zip(robot_file.robot.joints, joints, strict=True)
            if not limits.position[0] <= value <= limits.position[1]
        ),
    )


def _numbers(values: np.ndarray) -> tuple[float, ...]:
    return tuple(0.0 if abs(value) < SHOWN_AS_ZERO else float(value) for value in values)
