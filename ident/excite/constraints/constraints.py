"""All constraints of an excitation, from the robot file."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from daq.robot.loader import RobotFile
from daq.robot.obstacles import obstacles_of
from drivers.core.arrays import FloatArray
from drivers.core.errors import RobotFileError, UsageError
from ident.excite.constraints.collision_geometry import ArmGeometry, arm_geometry, link_name
from ident.excite.constraints.joint_limits import JointMotionLimits
from ident.excite.constraints.self_collision import LinkPairs, Pair, SelfCollision, link_pairs
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
        pairs = checked_pairs(robot_file, model, geometry)
        constraints.append(SelfCollision(model, geometry, pairs))
        if pairs.by_hull:
            return (*(constraint for constraint in constraints[:-1] if constraint.names), constraints[-1])
    return tuple(constraint for constraint in constraints if constraint.names)


def checked_pairs(robot_file: RobotFile, model: DynamicModel, geometry: ArmGeometry) -> LinkPairs:
    """Which pairs of links are kept apart.

    Raises:
        RobotFileError: none, since the file's `link_radius` makes all of them touch.
    """
    workspace = robot_file.robot.workspace
    pairs = link_pairs(model, geometry, workspace.ignore_pairs)
    if pairs.close and not pairs.checked and "link_radius" in workspace.model_fields_set:
        thin = ArmGeometry(tuple(replace(capsule, radius=0.0) for capsule in geometry.capsules), geometry.from_shapes)
        if link_pairs(model, thin, workspace.ignore_pairs).checked:
            raise RobotFileError(
                "with links as thick as this every pair touches in nearly every pose, so that none could be kept apart",
                where=f"{robot_file.where}: workspace.link_radius",
                hint="it is a radius in m",
            )
    return pairs


def unchecked_pairs(robot_file: RobotFile, model: DynamicModel) -> tuple[str, ...]:
    """The pairs of links, neighbours apart, that are not kept apart: `wrist_1_joint and wrist_3_joint`.

    Raises:
        RobotFileError: as `checked_pairs`.
    """
    pairs = checked_pairs(robot_file, model, arm_geometry(robot_file, model))
    return _named(model, (*pairs.close, *pairs.ignored))


def pairs_by_hull(robot_file: RobotFile, model: DynamicModel) -> tuple[str, ...]:
    """The pairs of links that the check of a motion keeps apart by their convex hulls, and a design does not at all.

    Raises:
        RobotFileError: as `checked_pairs`.
    """
    return _named(model, checked_pairs(robot_file, model, arm_geometry(robot_file, model)).by_hull)


def _named(model: DynamicModel, pairs: Iterable[Pair]) -> tuple[str, ...]:
    return tuple(f"{link_name(model, one)} and {link_name(model, other)}" for one, other in pairs)
