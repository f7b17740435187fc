"""The same arm as a Pinocchio model: for few samples, and for simulation."""

from __future__ import annotations

from typing import Any

import numpy as np

from drivers.core.arrays import FloatArray
from ident.model.dynamic_model import DynamicModel
from ident.model.kinematics.joints import BASE_INDEX
from ident.model.parameters import INERTIAL, inertia_tensor

# Pinocchio's dynamic parameters of a link, in its order (pinocchio::InertiaTpl::toDynamicParameters).
PINOCCHIO_ORDER = ("M", "MX", "MY", "MZ", "XX", "XY", "YY", "XZ", "YZ", "ZZ")


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
    return pin.Inertia(0.0, np.zeros(3), inertia_tensor(values[:6].tolist()))
