"""Feasible domain of the friction within I-IRLS (AUBO eq. 16).

What dissipates does not drive: f_c, f_v, f_L and the Stribeck term are not negative. The paper names bounds f_max of
every coefficient and no values; where they are asked for, no term of a joint's friction, its offset included, exceeds a
share of the joint's torque limit (of the largest measured torque, where the robot file has none) at the highest load
torque of the data and any speed up to their highest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.core.arrays import FloatArray
from ident.estimators.estimator import Setup
from ident.friction.table import DISSIPATIVE_KINDS, SLOPE_SPEED, TERMS, Operands
from ident.model.joint_columns import own_column
from ident.model.regressor import LoadTorqueKernel, RegressorKernel
from ident.regression.least_squares import LeastSquares, ordinary_least_squares
from ident.regression.observation_matrix import Reduction

BOUNDED = tuple(term for term in TERMS if term.needs in ("", "load"))
"""Terms whose coefficient has an upper bound: those of one sign."""


@dataclass(frozen=True, eq=False)
class FrictionBounds:
    """Least and largest values (b,) of base parameters; infinite for those other than friction of one joint."""

    least: FloatArray
    most: FloatArray

    def solution(self, reduction: Reduction, active: Sequence[int]) -> LeastSquares:
        """Least squares within the bounds; its covariance is that without them.

        Raises:
            IdentificationError: the system does not determine the parameters.
        """
        from scipy.optimize import lsq_linear

        free, columns = ordinary_least_squares(reduction, active), list(active)
        values, least, most = free.parameters[columns], self.least[columns], self.most[columns]
        if np.all((least <= values) & (values <= most)):
            return free
        factor = reduction.joints[0].factor
        lengths = np.linalg.norm(factor[:, columns], axis=0)
        bounded = lsq_linear(
            factor[:, columns] / lengths, factor[:, -1], (least * lengths, most * lengths), method="bvls"
        )
        parameters = free.parameters.copy()
        parameters[columns] = np.clip(bounded.x / lengths, least, most)
        return replace(free, parameters=parameters)

    def alone(self, reduction: Reduction, columns: Sequence[int], parameters: FloatArray) -> FloatArray:
        """These parameters within the bounds, by the torque that the others (b,), as they are, leave (eq. 15)."""
        held, joint = parameters.copy(), reduction.joints[0]
        held[columns] = 0.0
        factor = joint.factor.copy()
        factor[:, -1] -= factor[:, :-1] @ held
        left = replace(reduction, joints=(replace(joint, factor=factor),))
        return self.solution(left, columns).parameters[columns]

    def reached(self, parameters: FloatArray) -> tuple[int, ...]:
        """Base parameters (b,) that are at a bound."""
        return tuple(np.flatnonzero((parameters == self.least) | (parameters == self.most)).tolist())


def friction_bounds(setup: Setup, kernel: RegressorKernel, share: float | None) -> FrictionBounds:
    """The bounds on a robot's data.

    A base parameter that is a combination, such as an offset that holds a sliding joint's weight, has none.

    Args:
        setup: the data.
        kernel: with the friction's present shapes and load torque.
        share: of the joint's torque limit that one term can reach; None for no upper bounds.
    """
    base = setup.base
    alone = np.array(base.expressions) == np.array(base.names)
    dissipative = np.isin(base.kinds, DISSIPATIVE_KINDS)
    least, most = np.where(dissipative & alone, 0.0, -np.inf), np.full(base.count, np.inf)
    if share is None:
        return FrictionBounds(least, most)
    model = kernel.model
    speed, load, torque = _largest(setup, kernel)
    limits = {joint.name: joint.torque for joint in setup.robot_file.robot.joints}
    for motor, name in enumerate(model.joint_names):
        limit = share * (limits.get(name) or float(torque[motor]))
        for term in BOUNDED:
            place = own_column(model, kernel.columns, term.kind, motor)
            shape = model.terms.shape_of(term.kind, motor)
            largest = max(
                float(term.signal(Operands(at, 1.0, shape, load[motor]))) for at in (SLOPE_SPEED, speed[motor])
            )
            if place is None or not alone[place] or largest <= 0.0:
                continue
            most[place] = limit / largest
            least[place] = 0.0 if term.brakes else -limit
    return FrictionBounds(least, most)


def _largest(setup: Setup, kernel: RegressorKernel) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Largest speed, load torque and measured torque (n,) of the data."""
    model = kernel.model
    loads = None if model.terms.load_torque is None else LoadTorqueKernel(model)
    speed, load, torque = np.zeros(model.dof), np.zeros(model.dof), np.zeros(model.dof)
    for run in setup.runs:
        for segment in run.segments:
            speed = np.maximum(speed, np.max(np.abs(segment.velocity), axis=1))
            torque = np.maximum(torque, np.nanmax(np.abs(segment.torque), axis=1))
            if loads is not None:
                held = loads.torque(segment.position[:, :: run.parallel_filter.factor])
                load = np.maximum(load, np.max(np.abs(held), axis=1))
    return speed, load, torque
