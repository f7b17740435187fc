"""Inverse dynamics, gravity and inertia matrix of base parameters, at the joints; quick also for a single sample.

The torques here are those at the n joints with a motor, which give power with q̇; motors that several joints move have
R⁻ᵀ times these (SR400 eq. 6).

Base parameters are not the masses and inertias of bodies, but the dynamics are linear in the parameters: every standard
vector x with projection @ x = base has the same torques. Pinocchio divides by the masses, so x gets a mass of 1 kg for
each link whose mass is not kept, and the kept parameters make up for it. Where they cannot, or where a kept mass is
estimated as 0 or below, the link gets 1 kg and the torques of an arm of these extra point masses are subtracted.

The weight on a joint that slides along gravity is constant, and regrouped on the joint's offset. Gravity and friction
then need the standard parameters, of which base parameters do not tell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from drivers.core.arrays import FloatArray
from ident.friction.terms import NO_STATES, FrictionConditions, States
from ident.model.base_parameters import BaseParameters
from ident.model.compiled_rows import TreeTorques, compiled_torques
from ident.model.dynamic_model import DynamicModel
from ident.model.dynamics.pinocchio_model import pinocchio_model
from ident.model.joint_columns import JointColumn, alike, column_signal, joint_column
from ident.model.parameters import INERTIAL, LINK_SIZE
from ident.model.regressor import LoadTorqueKernel, model_torque

LOOP_BELOW = 400
"""Samples from which on the vectorised regressor is quicker than links and friction apart."""

PLACEHOLDER_MASS = 1.0
"""[kg] of a link whose mass is no base parameter."""

LEAST_MASS = 0.01
"""[kg]; links whose kept mass is less get `PLACEHOLDER_MASS`, and the difference is subtracted."""


NEGLIGIBLE_WEIGHT = 1e-6
"""[N/kg, N·m/(kg·m)] Shares of inertial parameters in an offset below this are rounding."""

_Arm = tuple[Any, Any, float]
"""A Pinocchio model, its data, and the sign with which its torques count."""


class InverseDynamics:
    """Torques of given base parameters along motions (n, N); scratch inside, so one thread at a time.

    Attributes:
        model: the arm.
        base: its base parameters.
        parameters: (b,) their values.
        coupling: (n, n) R of q_motor = R·q_joint.
        joint_columns: the columns that belong to no link, with their values.
        rotor_inertia: (n, n) of the motors, and of what turns with a coupled joint beside its motor [kg·m²].
        weight: (n,) constant gravity torque that is regrouped on offsets [N·m or N]; 0 where `standard` is not given.
        confounded: names of the joints whose weight and offset are one parameter that nothing splits.
    """

    def __init__(
        self,
        model: DynamicModel,
        base: BaseParameters,
        parameters: FloatArray,
        standard: FloatArray | None = None,
        armature: FloatArray | None = None,
    ) -> None:
        """Take over parameters.

        Args:
            model: the arm.
            base: its base parameters.
            parameters: (b,) their values.
            standard: (p,) standard parameters behind them, where they are known: they split weight from offset.
            armature: (n,) of the motors whose inertia the measured torque does not carry [kg·m²]; 0 where None.
        """
        self.model, self.base, self.parameters = model, base, parameters
        self.coupling = model.transmission.coupling
        own = np.zeros(model.dof) if armature is None else armature
        self.armature = np.asarray(self.coupling.T @ (own[:, None] * self.coupling))
        columns = model.parameters
        self.joint_columns: list[tuple[JointColumn, float]] = [
            (joint_column(model, columns[column]), float(value))
            for column, value in zip(base.columns, parameters, strict=True)
            if columns[column].kind != "inertial"
        ]
        self._alike, self._others = alike(self.joint_columns)
        self.rotor_inertia = self._summed_rotors()
        self.weight, self.confounded = self._regrouped_weight(standard)
        self._load = LoadTorqueKernel(model) if model.needs_load_torque else None

    @cached_property
    def _arms(self) -> list[_Arm]:
        return _arms(self.model, *with_masses(self.model, self.base, self.parameters))

    @cached_property
    def _compiled(self) -> TreeTorques | None:
        standard = np.zeros(len(self.model.parameters))
        standard[list(self.base.columns)] = self.parameters
        return compiled_torques(self.model.joints, self.model.gravity, standard[: LINK_SIZE * len(self.model.joints)])

    @cached_property
    def _load_arms(self) -> list[_Arm]:
        return [] if self._load is None else _load_arms(self.model)

    def torque(
        self,
        position: FloatArray,
        velocity: FloatArray,
        acceleration: FloatArray,
        temperature: FloatArray | None = None,
    ) -> FloatArray:
        """Joint torques (n, N) [N·m] of a motion (n, N) at joint temperatures (n, N) [K], where they matter.

        Raises:
            ModelError: the friction depends on a temperature, and none is given.
        """
        if position.shape[1] >= LOOP_BELOW:
            motors = model_torque(
                self.model, self.base.columns, self.parameters, position, velocity, acceleration, temperature
            )
            return self._to_joints(motors)
        total = self.links(position, velocity, acceleration) + self.rotor_inertia @ acceleration
        return total + self.friction(velocity, position, temperature) + self.weight[:, None]

    def gravity(self, position: FloatArray) -> FloatArray:
        """Joint torques (n, N) [N·m] of gravity; without the weights of joints that are `confounded`."""
        still = np.zeros_like(position)
        return self.links(position, still, still) + self.weight[:, None]

    def links(self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        """Joint torques (n, N) [N·m] of the links alone: no motor inertia, no friction, no regrouped weight."""
        if position.shape[1] <= 1 or self._compiled is None:
            return self._of_arms(self._arms, position, velocity, acceleration)
        motion = self.model.tree_motion(position, velocity, acceleration)
        tree = self._compiled(motion.position, motion.velocity, motion.acceleration)
        return self.model.transmission.from_tree(motion, tree)

    def _of_arms(
        self, arms: Sequence[_Arm], position: FloatArray, velocity: FloatArray, acceleration: FloatArray
    ) -> FloatArray:
        import pinocchio as pin

        motion = self.model.tree_motion(position, velocity, acceleration)
        motion_signals = (motion.position, motion.velocity, motion.acceleration)
        tree = np.zeros_like(motion.position)
        inverse = pin.rnea
        signals = [np.ascontiguousarray(signal.T) for signal in motion_signals]
        for arm, data, sign in arms:
            for sample, (q, rate, change) in enumerate(zip(*signals, strict=True)):
                tree[:, sample] += sign * inverse(arm, data, q, rate, change)
        return self.model.transmission.from_tree(motion, tree)

    def conditions(self, position: FloatArray | None, temperature: FloatArray | None) -> FrictionConditions:
        """Return what friction depends on beside the velocity, at positions (n, N) and temperatures (n, N) [K]."""
        if self._load is None or position is None:
            return FrictionConditions(None, temperature, position=position)
        if self._load_arms and position.shape[1] < LOOP_BELOW:
            still = np.zeros_like(position)
            at_joints = self._of_arms(self._load_arms, position, still, still)
            load = np.asarray(np.linalg.solve(self.coupling.T, at_joints))
            return FrictionConditions(load, temperature, position=position)
        return FrictionConditions(self._load.torque(position), temperature, position=position)

    def friction(
        self,
        velocity: FloatArray,
        position: FloatArray | None = None,
        temperature: FloatArray | None = None,
        presliding: States = NO_STATES,
    ) -> FloatArray:
        """Friction and offsets (n, N) [N·m] at joint velocities (n, N); of `confounded` joints with their weight.

        Args:
            velocity: (n, N) [rad/s or m/s].
            position: (n, N), where friction depends on it or on the load.
            temperature: (n, N) [K], where friction depends on it.
            presliding: states (N,) in place of sign(q̇), by the motion that rubs.

        Raises:
            ModelError: the friction depends on what is not given.
        """
        conditions = replace(self.conditions(position, temperature), presliding=presliding)
        motors = np.zeros_like(velocity)
        for group in self._alike:
            motors[group.joints] += group.torques(self.model, velocity, conditions)
        for column, value in self._others:
            signal = column_signal(self.model, column, velocity, velocity, conditions)
            for motor, factor in column.rows:
                motors[motor] += factor * value * signal
        return self._to_joints(motors) - self.weight[:, None]

    def inertia(self, position: FloatArray) -> FloatArray:
        """Inertia matrices (N, n, n) [kg·m²] at positions (n, N), motor inertias included."""
        # Column by column: Pinocchio's crba demands joints in depth-first order, which a robot file need not have.
        count, dof = position.shape[1], self.model.dof
        repeated = np.repeat(position, dof + 1, axis=1)
        units = np.tile(np.eye(dof, dof + 1), count)  # the last one holds the arm
        torques = self.links(repeated, np.zeros_like(repeated), units).reshape(dof, count, dof + 1)
        matrices = (torques[:, :, :dof] - torques[:, :, dof:]).transpose(1, 0, 2)
        return np.asarray(0.5 * (matrices + matrices.transpose(0, 2, 1)) + self.rotor_inertia)

    def _regrouped_weight(self, standard: FloatArray | None) -> tuple[FloatArray, tuple[str, ...]]:
        """`weight` and `confounded`."""
        at_motors = np.zeros((self.model.dof, 1))
        held = weights_in_offsets(self.model, self.base)
        if standard is None:
            return self._to_joints(at_motors)[:, 0], tuple(held)
        for row in held.values():
            shares = self.base.projection[row]
            links = len(INERTIAL) * len(self.model.joints)
            for motor, factor in joint_column(self.model, self.model.parameters[self.base.columns[row]]).rows:
                at_motors[motor] += factor * float(shares[:links] @ standard[:links])
        return self._to_joints(at_motors)[:, 0], ()

    def _summed_rotors(self) -> FloatArray:
        """Inertia (n, n) [kg·m²] of the motors, and of what turns with a coupled joint beside its motor."""
        matrix = np.zeros((self.model.dof, self.model.dof))
        for column, value in self.joint_columns:
            if column.quantity == "motor_inertia":
                for motor, factor in column.rows:
                    for joint, share in column.motion:
                        matrix[motor, joint] += factor * value * share
        return self._to_joints(matrix)

    def _to_joints(self, motors: FloatArray) -> FloatArray:
        return self.model.transmission.at_joints(motors)


def weights_in_offsets(model: DynamicModel, base: BaseParameters) -> dict[str, int]:
    """Joints whose weight no motion separates from a constant friction torque → the base parameter that is both.

    Those that slide along gravity, whatever the other joints do.
    """
    links = len(INERTIAL) * len(model.joints)
    return {
        model.link_names[model.parameters[column].joint]: row
        for row, column in enumerate(base.columns)
        if model.parameters[column].kind == "offset"
        and np.any(np.abs(base.projection[row, :links]) > NEGLIGIBLE_WEIGHT)
    }


def _arms(model: DynamicModel, inertial: FloatArray, extra: dict[int, float]) -> list[_Arm]:
    """Arms of inertial standard parameters (10·links,) and, to be subtracted, of the extra point masses in them."""
    arms = ((pinocchio_model(model, inertial), 1.0), (_point_masses(model, extra), -1.0))
    return [(arm, arm.createData(), sign) for arm, sign in arms if arm is not None]


def _load_arms(model: DynamicModel) -> list[_Arm]:
    """The same of the parameters that a model's load torque follows from."""
    load = model.terms.load_torque
    if load is None:
        return []
    standard = np.zeros(LINK_SIZE * len(model.joints))
    standard[list(load.columns)] = load.values
    return _arms(model, standard, _lift_masses(model, standard))


def _lift_masses(model: DynamicModel, standard: FloatArray) -> dict[int, float]:
    """Give links without a mass one, for Pinocchio divides by it, and return what they got: link → [kg]."""
    extra = {}
    for link in range(len(model.joints)):
        mass = 10 * link + INERTIAL.index("M")
        if standard[mass] < LEAST_MASS:
            extra[link] = PLACEHOLDER_MASS - float(standard[mass])
            standard[mass] = PLACEHOLDER_MASS
    return extra


def with_masses(
    model: DynamicModel, base: BaseParameters, parameters: FloatArray
) -> tuple[FloatArray, dict[int, float]]:
    """Inertial standard parameters (10·links,) with these dynamics but for extra point masses, link → [kg]."""
    standard = np.zeros(base.projection.shape[1])
    masses = {10 * link + INERTIAL.index("M"): link for link in range(len(model.joints))}
    # The mass on a vertical slide may be regrouped on its motor inertia and offset: those belong to no link.
    of_joints = [row for row, kind in enumerate(base.kinds) if kind != "inertial"]
    apart = [mass for mass in masses if mass not in base.columns and not np.any(base.projection[of_joints, mass])]
    standard[apart] = PLACEHOLDER_MASS
    standard[list(base.columns)] = parameters - base.projection @ standard
    return standard[: LINK_SIZE * len(model.joints)], _lift_masses(model, standard)


def _point_masses(model: DynamicModel, masses: dict[int, float]) -> Any:
    """An arm of point masses at the origins of these links' frames; None where there are none."""
    import pinocchio as pin

    if not masses:
        return None
    arm = pinocchio_model(model)
    for link, mass in masses.items():
        arm.inertias[link + 1] = pin.Inertia(mass, np.zeros(3), np.zeros((3, 3)))
    return arm
