"""Inverse dynamics, gravity and inertia matrix of base parameters, at the joints; quick also for a single sample.

The torques here are those at the n joints with a motor, which give power with q̇; motors that several joints move have
R⁻ᵀ times these (SR400 eq. 6).

Base parameters are not the masses and inertias of bodies, but the dynamics are linear in the parameters: every standard
vector x with projection @ x = base has the same torques. Pinocchio divides by the masses, so x gets a mass of 1 kg for
each link whose mass is not kept, and the kept parameters make up for it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from drivers.streams import FloatArray
from ident.model.base_parameters import BaseParameters
from ident.model.dynamics import DynamicModel
from ident.model.joint_columns import JointColumn, column_signal, joint_column
from ident.model.pinocchio_model import pinocchio_model
from ident.model.regressor import model_torque

LOOP_BELOW = 400
"""Fewer samples than this go through Pinocchio one by one; from there on the vectorised regressor is quicker."""

PLACEHOLDER_MASS = 1.0
"""[kg] of a link whose mass is no base parameter."""

LEAST_MASS = 1e-6
"""[kg] in place of a kept mass of 0, as the essential model may have it: too little for a torque to show."""


class InverseDynamics:
    """Torques of given base parameters along motions (n, N); scratch inside, so one thread at a time.

    Attributes:
        model: the arm.
        base: its base parameters.
        parameters: (b,) their values.
        coupling: (n, n) R of q_motor = R·q_joint.
    """

    def __init__(self, model: DynamicModel, base: BaseParameters, parameters: FloatArray) -> None:
        self.model, self.base, self.parameters = model, base, parameters
        self.coupling = np.eye(model.dof) if model.transmission is None else model.transmission.coupling
        self._coupled = model.transmission is not None and not np.array_equal(self.coupling, np.eye(model.dof))
        standard = model.parameters
        self._joint_columns: list[tuple[JointColumn, float]] = [
            (joint_column(model, standard[column]), float(value))
            for column, value in zip(base.columns, parameters, strict=True)
            if standard[column].kind != "inertial"
        ]
        self._rotors = self._rotor_inertia()
        self._arm: Any = pinocchio_model(model, _with_masses(model, base, parameters))
        self._data = self._arm.createData()

    def torque(self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        """Joint torques (n, N) [N·m] of a motion (n, N)."""
        if position.shape[1] >= LOOP_BELOW:
            motors = model_torque(self.model, self.base.columns, self.parameters, position, velocity, acceleration)
            return self._to_joints(motors)
        total = self.links(position, velocity, acceleration) + self._rotors @ acceleration
        return total + self.friction(velocity)

    def links(self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        """Joint torques (n, N) [N·m] of the links alone: no motor inertia, no friction."""
        import pinocchio as pin

        motion = self.model.tree_motion(position, velocity, acceleration)
        motion_signals = (motion.position, motion.velocity, motion.acceleration)
        tree = np.empty_like(motion.position)
        inverse, arm, data = pin.rnea, self._arm, self._data
        signals = zip(*(np.ascontiguousarray(signal.T) for signal in motion_signals), strict=True)
        for sample, (q, rate, change) in enumerate(signals):
            tree[:, sample] = inverse(arm, data, q, rate, change)
        return tree if self.model.transmission is None else _from_tree(motion.follow, tree)

    def friction(self, velocity: FloatArray) -> FloatArray:
        """Friction and offsets (n, N) [N·m] at joint velocities (n, N)."""
        motors = np.zeros_like(velocity)
        for column, value in self._joint_columns:
            if column.quantity != "motor_inertia":
                signal = column_signal(self.model, column, velocity, velocity)
                for motor, factor in column.rows:
                    motors[motor] += factor * value * signal
        return self._to_joints(motors)

    def inertia(self, position: FloatArray) -> FloatArray:
        """Inertia matrices (N, n, n) [kg·m²] at positions (n, N), motor inertias included."""
        import pinocchio as pin

        still = np.zeros_like(position)
        motion = self.model.tree_motion(position, still, still)
        joints, count = motion.position.shape
        upper = np.empty((count, joints, joints))
        composite, arm, data = pin.crba, self._arm, self._data
        for sample, q in enumerate(motion.position.T):
            upper[sample] = composite(arm, data, q)
        matrices = np.triu(upper) + np.triu(upper, 1).transpose(0, 2, 1)
        if self.model.transmission is not None:
            follow = motion.follow if motion.follow.ndim == 2 else np.moveaxis(motion.follow, -1, 0)
            matrices = np.swapaxes(follow, -1, -2) @ matrices @ follow
        return np.asarray(matrices + self._rotors)

    def _rotor_inertia(self) -> FloatArray:
        """Inertia (n, n) [kg·m²] of the motors, and of what turns with a coupled joint beside its motor."""
        matrix = np.zeros((self.model.dof, self.model.dof))
        for column, value in self._joint_columns:
            if column.quantity == "motor_inertia":
                for motor, factor in column.rows:
                    for joint, share in column.motion:
                        matrix[motor, joint] += factor * value * share
        return self._to_joints(matrix)

    def _to_joints(self, motors: FloatArray) -> FloatArray:
        return np.asarray(self.coupling.T @ motors) if self._coupled else motors


def _from_tree(follow: FloatArray, tree: FloatArray) -> FloatArray:
    """Gᵀ times torques (m, N) of the tree's joints: those (n, N) at the joints with a motor."""
    return np.asarray(follow.T @ tree if follow.ndim == 2 else np.einsum("mnN,mN->nN", follow, tree))


def _with_masses(model: DynamicModel, base: BaseParameters, parameters: FloatArray) -> FloatArray:
    """Inertial standard parameters (10·links,) with the dynamics of these base parameters and masses that are not 0."""
    standard = np.zeros(base.projection.shape[1])
    masses = range(9, 10 * len(model.joints), 10)
    standard[[mass for mass in masses if mass not in base.columns]] = PLACEHOLDER_MASS
    standard[list(base.columns)] = parameters - base.projection @ standard
    for mass in masses:
        if abs(standard[mass]) < LEAST_MASS:
            standard[mass] = LEAST_MASS
    return standard[: 10 * len(model.joints)]
