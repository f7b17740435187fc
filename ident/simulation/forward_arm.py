"""What a simulation needs of an arm at one instant: inertia matrix, bias torque, viscous and dry friction.

At the n joints with a motor, as `ident.model.inverse_dynamics` has it:

    M(q)·q̈ + b(q, q̇) + V·q̇ + Dᵀ·λ = τ        λᵢ = fᵢ·sign(Dᵢ·q̇), anything between −fᵢ and fᵢ where Dᵢ·q̇ = 0
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drivers.errors import ModelError
from drivers.streams import FloatArray
from ident.model.dynamic_model import DynamicModel
from ident.model.inverse_dynamics import InverseDynamics, with_masses
from ident.model.joint_columns import combined
from ident.model.parameters import INERTIAL
from ident.model.rigid_arm import RigidArm, rigid_arm


class ForwardArm:
    """An arm with given base parameters, one sample at a time; scratch inside, so one thread at a time.

    Attributes:
        dof: number n of joints with a motor.
        viscous: (n, n) V [N·m·s/rad].
        offset: (n,) constant torque, part of the bias [N·m].
        directions: (m, n) D, the joint motions that dry friction acts on.
        dry: (m,) f, dry friction in each of them [N·m].
    """

    def __init__(self, inverse: InverseDynamics) -> None:
        """Take over parameters.

        Raises:
            ModelError: a dry friction below 0, which would drive the arm.
        """
        model = inverse.model
        self.dof = model.dof
        self.viscous = np.zeros((self.dof, self.dof))
        self.offset = np.zeros(self.dof)
        directions, dry = [], []
        identity = np.eye(self.dof)
        for column, value in inverse.joint_columns:
            at_motors = np.zeros(self.dof)
            for motor, factor in column.rows:
                at_motors[motor] += factor * value
            at_joints = inverse.coupling.T @ at_motors
            motion = np.array(combined(column.motion, identity), dtype=np.float64)
            if column.quantity == "viscous":
                self.viscous += np.outer(at_joints, motion)
            elif column.quantity == "offset":
                self.offset += at_joints
            elif column.quantity == "coulomb":
                directions.append(motion)
                dry.append(float(at_joints @ motion / (motion @ motion)))
        self.directions, self.dry = np.array(directions).reshape(-1, self.dof), np.array(dry)
        _check_dissipative(model, self.directions, self.dry)
        self._rotors = inverse.rotor_inertia
        self._arms = _rigid_arms(model, inverse)

    def inertia(self, position: FloatArray) -> FloatArray:
        """M (n, n) [kg·m²] at a position (n,), motor inertia included."""
        total = self._rotors.copy()
        for arm, sign in self._arms:
            total += sign * arm.inertia(position)
        return total

    def bias(self, position: FloatArray, velocity: FloatArray) -> FloatArray:
        """B (n,) [N·m]: gravity, Coriolis and centrifugal torque, and offsets."""
        total = self.offset.copy()
        for arm, sign in self._arms:
            total += sign * arm.bias(position, velocity)
        return total


def _rigid_arms(model: DynamicModel, inverse: InverseDynamics) -> list[tuple[RigidArm, float]]:
    """The links, without motors, at the joints; and the point masses that are taken off again, where there are any."""
    transmission = model.transmission
    if transmission is not None:  # torque and motion of the joints, not of coupled motors
        model = replace(model, transmission=replace(transmission, coupling=np.eye(model.dof)))
    inertial, extra = with_masses(inverse.model, inverse.base, inverse.parameters)
    arms = [(rigid_arm(model, inertial, np.zeros(model.dof)), 1.0)]
    if extra:
        points = np.zeros_like(inertial)
        for link, mass in extra.items():
            points[len(INERTIAL) * link + INERTIAL.index("M")] = mass
        arms.append((rigid_arm(model, points, np.zeros(model.dof)), -1.0))
    return arms


def _check_dissipative(model: DynamicModel, directions: FloatArray, dry: FloatArray) -> None:
    wrong = [
        f"{model.joint_names[int(np.argmax(np.abs(motion)))]} ({value:.3g} N·m)"
        for motion, value in zip(directions, dry, strict=True)
        if value < 0.0
    ]
    if wrong:
        raise ModelError(
            f"negative Coulomb friction (not dissipative) of {', '.join(wrong)}: a joint at rest would never stay so",
            where=model.name,
            hint='simulate the physically consistent model (parameters="consistent", the default)',
        )
