"""All constraints of an excitation, from the robot file."""

from __future__ import annotations

import numpy as np

from daq.robot.loader import RobotFile
from daq.robot.obstacles import obstacles_of
from drivers.errors import UsageError
from drivers.streams import FloatArray
from ident.excite.constraints.collision_geometry import arm_geometry
from ident.excite.constraints.joint_limits import JointMotionLimits
from ident.excite.constraints.self_collision import SelfCollision, link_pairs
from ident.excite.constraints.torque_limits import TorqueLimits
from ident.excite.constraints.workspace import WorkspaceLimits
from ident.excite.path import Constraint
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import DynamicModel


def constraints_of(
    robot_file: RobotFile, model: DynamicModel, parameters: FloatArray | None, self_collision: bool
) -> tuple[Constraint, ...]:
    """Constraints on a motion of this arm, those with no value left out.

    Args:
        robot_file: with the limits and the section `workspace`.
        model: of the same file.
        parameters: base parameters (b,) known beforehand, for the torque; None where there are none.
        self_collision: whether the links must stay clear of each other.

    Raises:
        RobotFileError: the URDF and the file's joints do not fit together; the workspace leaves no room for any motion.
        UsageError: the parameters are not as many as the arm's base parameters, or not finite.
    """
    constraints: list[Constraint] = [JointMotionLimits(model.limits)]
    if parameters is not None:
        columns = base_parameters(model).columns
        if np.shape(parameters) != (len(columns),) or not np.all(np.isfinite(parameters)):
            raise UsageError(
                f"the torque limits need {len(columns)} finite base parameters, not {np.size(parameters)}",
                where=model.name,
                hint="take them from a result of this robot file",
            )
        if any(limits.torque is not None for limits in model.limits):
            constraints.append(TorqueLimits(model, columns, parameters))
    geometry = arm_geometry(robot_file, model)
    constraints.append(WorkspaceLimits(model, geometry, robot_file.robot.workspace, obstacles_of(robot_file.robot)))
    if self_collision:
        pairs = link_pairs(model, geometry, robot_file.robot.workspace.ignore_pairs)
        constraints.append(SelfCollision(model, geometry, pairs))
    return tuple(constraint for constraint in constraints if constraint.names)
