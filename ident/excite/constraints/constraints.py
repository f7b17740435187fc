"""All constraints of an excitation, from the robot file.

A solver tries motions far outside the limits before it converges, and there a general loop may not close. Criteria and
constraints of an arm with such loops are therefore evaluated with every position clipped to its limits. For feasible
motions, the only ones that a design returns, this changes nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from daq.robot.loader import RobotFile
from daq.robot.obstacles import obstacles_of
from daq.robot.schema import JointLimits
from drivers.core.arrays import FloatArray
from drivers.core.errors import RobotFileError, UsageError
from ident.excite.constraints.collision_geometry import ArmGeometry, arm_geometry, link_name
from ident.excite.constraints.self_collision import LinkPairs, Pair, SelfCollision, link_pairs
from ident.excite.constraints.torque_limits import JointMotionLimits, TorqueLimits
from ident.excite.constraints.workspace import WorkspaceLimits
from ident.excite.criteria import Criterion
from ident.excite.path import Constraint, JointPath
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import DynamicModel


def constraints_of(
    robot_file: RobotFile, model: DynamicModel, parameters: FloatArray | None, self_collision: bool
) -> tuple[Constraint, ...]:
    """Constraints on a motion of this arm, those with no value left out; on torque where parameters (b,) are known.

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
                hint="use those of a result of this robot file",
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
    """Return which pairs of links are kept apart.

    Raises:
        RobotFileError: none, since the file's `link_radius` makes all of them touch.
    """
    workspace = robot_file.robot.workspace
    pairs = link_pairs(model, geometry, workspace.ignore_pairs)
    if pairs.close and not pairs.checked and "link_radius" in workspace.model_fields_set:
        thin = ArmGeometry(tuple(replace(capsule, radius=0.0) for capsule in geometry.capsules), geometry.from_shapes)
        if link_pairs(model, thin, workspace.ignore_pairs).checked:
            raise RobotFileError(
                "with links this thick every pair touches in nearly every pose, so none could be checked",
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
    return tuple(f"{link_name(model, first)} and {link_name(model, second)}" for first, second in pairs)


def criterion_within_limits(model: DynamicModel, criterion: Criterion) -> Criterion:
    """The criterion, evaluated within the position limits for arms with general loops."""
    return _CriterionWithin(model.limits, criterion) if _may_not_close(model) else criterion


def constraints_within_limits(model: DynamicModel, constraints: Sequence[Constraint]) -> tuple[Constraint, ...]:
    """The constraints, for arms with general loops all but the joints' own evaluated within the position limits."""
    if not _may_not_close(model):
        return tuple(constraints)
    return tuple(
        constraint if isinstance(constraint, JointMotionLimits) else _ConstraintWithin(model.limits, constraint)
        for constraint in constraints
    )


def _may_not_close(model: DynamicModel) -> bool:
    return model.transmission.solved_numerically


class _CriterionWithin:
    def __init__(self, limits: Sequence[JointLimits], criterion: Criterion) -> None:
        self._limits = limits
        self._criterion = criterion

    def cost(self, path: JointPath) -> float:
        return self._criterion.cost(_moved(path, self._limits)[0])

    def smooth_cost(self, path: JointPath, sharpness: float) -> tuple[float, FloatArray]:
        moved, outside = _moved(path, self._limits)
        cost, gradient = self._criterion.smooth_cost(moved, sharpness)
        gradient[0][outside] = 0.0
        return cost, gradient


class _ConstraintWithin:
    def __init__(self, limits: Sequence[JointLimits], constraint: Constraint) -> None:
        self._limits = limits
        self._constraint = constraint

    @property
    def names(self) -> tuple[str, ...]:
        return self._constraint.names

    def use(self, path: JointPath) -> FloatArray:
        return self._constraint.use(_moved(path, self._limits)[0])

    def smooth_use(self, path: JointPath, sharpness: float) -> tuple[FloatArray, FloatArray]:
        moved, outside = _moved(path, self._limits)
        bounds, gradient = self._constraint.smooth_use(moved, sharpness)
        gradient[:, 0, outside] = 0.0
        return bounds, gradient


def _moved(path: JointPath, limits: Sequence[JointLimits]) -> tuple[JointPath, np.ndarray]:
    """The path with its positions moved into the limits, and which (n, N) were."""
    low, high = (np.array(limit)[:, None] for limit in zip(*(joint.position for joint in limits), strict=True))
    # A diverging solver asks for NaN positions; NaN velocities are the answer.
    position = np.clip(np.where(np.isfinite(path.position), path.position, low), low, high)
    return JointPath(path.time, position, path.velocity, path.acceleration), position != path.position
