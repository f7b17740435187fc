"""The regressor by Pinocchio, sample by sample: what dynid's own is compared with."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from drivers.core.arrays import FloatArray
from ident.friction.terms import FrictionConditions
from ident.model.dynamic_model import DynamicModel
from ident.model.dynamics.pinocchio_model import PINOCCHIO_ORDER, pinocchio_model
from ident.model.joint_columns import NO_CONDITIONS, column_signal, joint_column
from ident.model.parameters import INERTIAL

_TO_OURS = tuple(PINOCCHIO_ORDER.index(symbol) for symbol in INERTIAL)


def pinocchio_regressor(
    model: DynamicModel,
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    conditions: FrictionConditions = NO_CONDITIONS,
) -> FloatArray:
    """Standard regressor (n, p, N) for (n, N) motions, by `pin.computeJointTorqueRegressor` sample by sample."""

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
        rows = pin.computeJointTorqueRegressor(arm, data, *(signal[:, sample] for signal in tree))
        # Pinocchio gives a one-joint arm's regressor as a vector.
        ordered = np.reshape(rows, (links, -1))[:, order]
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
