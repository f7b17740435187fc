"""Criteria and constraints clipped to the position limits, for arms with general loops.

A solver tries motions far outside the limits before it converges, and there a loop may not close. Criteria and
constraints of the whole arm are therefore evaluated with every position clipped to its limits. For feasible motions,
the only ones that a design returns, this changes nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daq.robot.schema import JointLimits
from drivers.core.arrays import FloatArray
from ident.excite.constraints.joint_limits import JointMotionLimits
from ident.excite.criteria import Criterion
from ident.excite.path import Constraint, JointPath
from ident.model.dynamic_model import DynamicModel


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
