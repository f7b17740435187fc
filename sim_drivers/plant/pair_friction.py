"""Friction of coupled joints in a simulated arm, beside their motors' (SR400 eq. 8, with its signs as printed)."""

from __future__ import annotations

import numpy as np

from daq.robot.schema import Robot, TruthJoint
from drivers.core.arrays import FloatArray
from ident.model.dynamic_model import DynamicModel

WIDTH = 0.01
"""Width [rad/s] of the smoothed sign: the joint has no bristle, its motor's holds it at rest."""


class PairFriction:
    """Fs·sign(q̇) + Fv·q̇ of every coupled joint q̇ = R⁻¹·q̇_m, mapped to the motors by −R⁻ᵀ."""

    def __init__(self, robot: Robot, model: DynamicModel) -> None:
        joints = [robot.truth.joints.get(name, TruthJoint()) for name in robot.joint_names]
        transmission = model.transmission
        present = np.zeros(model.dof) if transmission is None else np.array(transmission.pair_friction, dtype=float)
        self._viscous = present * [joint.pair_viscous for joint in joints]
        self._coulomb = present * [joint.pair_coulomb for joint in joints]
        self._to_joints = np.eye(model.dof) if transmission is None else np.linalg.inv(transmission.coupling)
        self.present = bool(np.any(self._viscous) or np.any(self._coulomb))

    def torque(self, velocity: FloatArray) -> FloatArray:
        """Friction torque (n,) [N·m] at the motors for their velocities (n,), counted as the motors' own is."""
        joint_velocity = self._to_joints @ velocity
        at_joints = self._viscous * joint_velocity + self._coulomb * np.tanh(joint_velocity / WIDTH)
        return np.asarray(-self._to_joints.T @ at_joints)
