"""The same arm as a Pinocchio model: for few samples, for simulation, and as the reference in tests."""

from __future__ import annotations

from typing import Any

import numpy as np

from drivers.core.arrays import FloatArray
from ident.friction.terms import FrictionConditions
from ident.model.dynamic_model import DynamicModel
from ident.model.joint_columns import NO_CONDITIONS, column_signal, joint_column
from ident.model.kinematics.joints import BASE_INDEX
from ident.model.parameters import INERTIAL

# Pinocchio's dynamic parameters of a link, in its order (pinocchio::InertiaTpl::toDynamicParameters).
PINOCCHIO_ORDER = ("M", "MX", "MY", "MZ", "XX", "XY", "YY", "XZ", "YZ", "ZZ")
_TO_OURS = tuple(PINOCCHIO_ORDER.index(symbol) for symbol in INERTIAL)


def pinocchio_model(model: DynamicModel, inertial: FloatArray | None = None) -> Any:
    """A `pinocchio.Model` of the tree, joints in our order; `inertial` (10·n,) sets its links (massless where None)."""
    import pinocchio as pin

    result = pin.Model()
    result.name = model.name
    limits_of = dict(zip(model.active, model.limits, strict=True))
    for index, joint in enumerate(model.joints):
        kind = pin.JointModelPrismaticUnaligned if joint.prismatic else pin.JointModelRevoluteUnaligned
        parent = 0 if joint.parent == BASE_INDEX else joint.parent + 1
        placement = pin.SE3(joint.rotation, joint.translation)
        identifier = result.addJoint(parent, kind(joint.axis), placement, joint.name)
        if index in limits_of:
            result.lowerPositionLimit[index], result.upperPositionLimit[index] = limits_of[index].position
        if inertial is not None:
            result.inertias[identifier] = _body(inertial[10 * index : 10 * index + 10])
    result.gravity.linear = model.gravity
    return result


def _body(values: FloatArray) -> Any:
    """A `pinocchio.Inertia` of ten standard parameters.

    Raises:
        ValueError: first moments without a mass, which no centre of mass has.
    """
    import pinocchio as pin

    dynamic = np.array([values[INERTIAL.index(symbol)] for symbol in PINOCCHIO_ORDER])
    if dynamic[0] != 0.0:
        return pin.Inertia.FromDynamicParameters(dynamic)
    if np.any(dynamic[1:4]):
        raise ValueError("a link without mass has first moments")
    # Pinocchio would divide by the mass.
    xx, xy, yy, xz, yz, zz = dynamic[4:]
    return pin.Inertia(0.0, np.zeros(3), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))


def pinocchio_regressor(
    model: DynamicModel,
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    conditions: FrictionConditions = NO_CONDITIONS,
) -> FloatArray:
    """Standard regressor (n, p, N) for (n, N) motions, by `pin.computeJointTorqueRegressor` sample by sample."""
    import pinocchio as pin

    arm = pinocchio_model(model)
    data = arm.createData()
    count, links = position.shape[1], len(model.joints)
    order = [10 * link + column for link in range(links) for column in _TO_OURS]
    parameters = model.parameters
    dense = np.zeros((model.dof, len(parameters), count))
    motion = model.tree_motion(position, velocity, acceleration)
    tree = motion.position, motion.velocity, motion.acceleration
    shares = None if model.transmission.direct else model.transmission.to_motors(motion.follow)
    for sample in range(count):
        one = pin.computeJointTorqueRegressor(arm, data, *(signal[:, sample] for signal in tree))
        # Pinocchio gives a one-joint arm's regressor as a vector.
        ordered = np.reshape(one, (links, -1))[:, order]
        if shares is not None:
            ordered = (shares if shares.ndim == 2 else shares[..., sample]) @ ordered
        dense[:, : 10 * links, sample] = ordered
    for index, parameter in enumerate(parameters):
        if parameter.kind != "inertial":
            column = joint_column(model, parameter)
            signal = column_signal(model, column, velocity, acceleration, conditions)
            for motor, factor in column.rows:
                dense[motor, index] = factor * signal
    return dense
