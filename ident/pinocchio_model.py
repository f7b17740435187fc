"""The same arm as a Pinocchio model: for few samples, for simulation, and as the reference in tests."""

from __future__ import annotations

from typing import Any

import numpy as np

from ident.kinematics import BASE_INDEX, FloatArray
from ident.model import INERTIAL, DynamicModel

# Pinocchio's dynamic parameters of a link, in its order (pinocchio::InertiaTpl::toDynamicParameters).
PINOCCHIO_ORDER = ("M", "MX", "MY", "MZ", "XX", "XY", "YY", "XZ", "YZ", "ZZ")
_TO_OURS = tuple(PINOCCHIO_ORDER.index(symbol) for symbol in INERTIAL)


def pinocchio_model(model: DynamicModel, inertial: FloatArray | None = None) -> Any:
    """A `pinocchio.Model` with our joints in our order; `inertial` (10·n,) sets its links (massless where None)."""
    import pinocchio as pin

    result = pin.Model()
    result.name = model.name
    for number, (joint, limits) in enumerate(zip(model.joints, model.limits, strict=True)):
        kind = pin.JointModelPrismaticUnaligned if joint.prismatic else pin.JointModelRevoluteUnaligned
        parent = 0 if joint.parent == BASE_INDEX else joint.parent + 1
        placement = pin.SE3(joint.rotation, joint.translation)
        identifier = result.addJoint(parent, kind(joint.axis), placement, joint.name)
        result.lowerPositionLimit[number], result.upperPositionLimit[number] = limits.position
        if inertial is not None:
            values = inertial[10 * number : 10 * number + 10]
            dynamic = np.array([values[INERTIAL.index(symbol)] for symbol in PINOCCHIO_ORDER])
            result.inertias[identifier] = pin.Inertia.FromDynamicParameters(dynamic)
    result.gravity.linear = model.gravity
    return result


def pinocchio_regressor(
    model: DynamicModel, position: FloatArray, velocity: FloatArray, acceleration: FloatArray
) -> FloatArray:
    """Standard regressor (n, p, N) for (n, N) motions, by `pin.computeJointTorqueRegressor` sample by sample."""
    import pinocchio as pin

    arm = pinocchio_model(model)
    data = arm.createData()
    count = position.shape[1]
    order = [10 * link + column for link in range(model.dof) for column in _TO_OURS]
    parameters = model.parameters
    dense = np.zeros((model.dof, len(parameters), count))
    for sample in range(count):
        one = pin.computeJointTorqueRegressor(
            arm, data, position[:, sample], velocity[:, sample], acceleration[:, sample]
        )
        # Pinocchio gives a one-joint arm's regressor as a vector.
        dense[:, : 10 * model.dof, sample] = np.reshape(one, (model.dof, -1))[:, order]
    for column, parameter in enumerate(parameters):
        if parameter.kind == "motor_inertia":
            dense[parameter.joint, column] = acceleration[parameter.joint]
        elif parameter.kind == "viscous":
            dense[parameter.joint, column] = velocity[parameter.joint]
        elif parameter.kind == "coulomb":
            dense[parameter.joint, column] = model.coulomb_direction(velocity[parameter.joint])
        elif parameter.kind == "offset":
            dense[parameter.joint, column] = 1.0
    return dense
