"""What a simulation needs of an arm at one instant: inertia matrix, bias torque, viscous and dry friction.

At the n joints with a motor, as `ident.model.dynamics.inverse_dynamics` has it:

    M(q)·q̈ + b(q, q̇) + V·q̇ + Dᵀ·λ = τ        λᵢ = fᵢ·sign(Dᵢ·q̇), anything between −fᵢ and fᵢ where Dᵢ·q̇ = 0

Dry friction is Coulomb's, with what depends on load and speed (Stribeck) where the model has it: fᵢ then changes from
step to step. Where the model has presliding, λᵢ = fᵢ·zᵢ with Dahl's state z. What vanishes at rest without being
linear, |q̇|^α and √|q̇|, is viscous friction whose coefficient changes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import ModelError
from drivers.core.units import joint_unit
from ident.friction.table import SLOPE_SPEED, TERM
from ident.friction.terms import FrictionConditions
from ident.model.dynamic_model import DynamicModel
from ident.model.dynamics.inverse_dynamics import InverseDynamics, with_masses
from ident.model.dynamics.rigid_arm import RigidArm, rigid_arm
from ident.model.joint_columns import JointColumn, column_signal, combined
from ident.model.parameters import INERTIAL
from ident.model.presliding import presliding_motions


@dataclass(frozen=True, eq=False)
class _Term:
    """A friction column along its motion: torques (n,) at the joints per unit of signal, and the motion (n,)."""

    column: JointColumn
    at_joints: FloatArray
    motion: FloatArray


class ForwardArm:
    """An arm with given base parameters, one sample at a time; scratch inside, so one thread at a time.

    Attributes:
        dof: number n of joints with a motor.
        viscous: (n, n) V [N·m·s/rad] of linear viscous friction that brakes.
        offset: (n,) constant torque, part of the bias [N·m].
        directions: (m, n) D, the joint motions that dry friction acts on.
        dry: (m,) f, Coulomb friction in each of them [N·m].
        travel: (m,) δ, pre-sliding travel [rad or m] of each of them; 0 without.
        model: the arm.
        inertial: (10·links,) standard parameters of its links with these dynamics.
        rotors: (n, n) inertia of the motors at the joints [kg·m²].
        joint_names: (n,).
        sliding: (n,) whether a joint slides, with N and m in place of N·m and rad.
    """

    def __init__(self, inverse: InverseDynamics, kelvin: FloatArray | None = None) -> None:
        """Take over parameters, and temperatures (n,) [K] of the joints where friction depends on them.

        Raises:
            ModelError: a dry friction below 0, which would drive the arm.
        """
        model = inverse.model
        self._inverse, self._unsmoothed = inverse, replace(model, smoothing=0.0)
        self._kelvin = None if kelvin is None else kelvin[:, None]
        self._smooth: list[_Term] = []
        self._ripple: list[_Term] = []
        self._further_dry: list[tuple[int, _Term]] = []
        self.dof, self.joint_names, self.sliding = model.dof, model.joint_names, model.sliding
        self.viscous, self._accelerating = np.zeros((self.dof, self.dof)), np.zeros((self.dof, self.dof))
        self.offset = np.zeros(self.dof)
        directions, dry, travel = [], [], []
        travels = presliding_motions(model)
        identity = np.eye(self.dof)
        for column, value in inverse.joint_columns:
            if column.quantity not in TERM:  # the motor's inertia is among the rotors'
                continue
            at_motors = np.zeros(self.dof)
            for motor, factor in column.rows:
                at_motors[motor] += factor * value
            at_joints = inverse.coupling.T @ at_motors
            motion = np.array(combined(column.motion, identity), dtype=np.float64)
            along = replace(column, motion=((0, 1.0),))
            if column.quantity == "viscous" and column.shape == 1.0:
                matrix = self.viscous if at_joints @ motion >= 0.0 else self._accelerating
                matrix += np.outer(at_joints, motion)
            elif column.quantity == "offset":
                self.offset += at_joints
            elif column.quantity == "coulomb":
                directions.append(motion)
                dry.append(float(at_joints @ motion / (motion @ motion)))
                travel.append(travels.get(column.motion, 0.0))
            elif not TERM[column.quantity].rubs:
                self._ripple.append(_Term(along, at_joints, motion))
            elif TERM[column.quantity].dry:
                same = [place for place, other in enumerate(directions) if np.array_equal(other, motion)]
                if not same:
                    same = [len(directions)]
                    directions.append(motion)
                    dry.append(0.0)
                    travel.append(travels.get(column.motion, 0.0))
                self._further_dry.append((same[0], _Term(along, at_joints, motion)))
            else:
                self._smooth.append(_Term(along, at_joints, motion))
        self.directions, self.dry = np.array(directions).reshape(-1, self.dof), np.array(dry)
        self.travel = np.array(travel)
        _check_dissipative(model, self.directions, self.dry)
        self.model, self.rotors = model, inverse.rotor_inertia + inverse.armature
        self._massive, self._points = _inertial(inverse)
        self.inertial = self._massive - self._points

    @cached_property
    def _arms(self) -> list[tuple[RigidArm, float]]:
        """Arms without motors: the links, and point masses to be taken off, if any. The compiled step needs none."""
        # Torque and motion of the joints, not of coupled motors.
        model = replace(self.model, transmission=replace(self.model.transmission, coupling=np.eye(self.dof)))
        arms = [(self._massive, 1.0), (self._points, -1.0)]
        return [(rigid_arm(model, links, np.zeros(self.dof)), sign) for links, sign in arms if links.any()]

    @property
    def accelerated(self) -> tuple[str, ...]:
        """Names of the joints that negative linear viscous friction accelerates."""
        return tuple(self.joint_names[joint] for joint in np.flatnonzero(self._accelerating.any(axis=1)))

    def inertia(self, position: FloatArray) -> FloatArray:
        """M (n, n) [kg·m²] at a position (n,), motor inertia included, also that which no measured torque carries."""
        total = self.rotors.copy()
        for arm, sign in self._arms:
            total += sign * arm.inertia(position)
        return total

    def viscous_at(self, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
        """V (n, n) [N·m·s/rad] of all friction that vanishes at rest, and a torque (n,) [N·m], at a velocity (n,).

        What grows with the velocity is in V. What falls, a term with a negative coefficient, is the torque: as a
        viscous coefficient it would be unstable.
        """
        torque = self._accelerating @ velocity
        if not self._smooth:
            return self.viscous, torque
        matrix = self.viscous.copy()
        conditions = FrictionConditions(temperature=self._kelvin)
        for term in self._smooth:
            speed = np.array([max(abs(float(term.motion @ velocity)), SLOPE_SPEED)])
            slope = float(self._signal(term, speed, conditions)[0] / speed[0])
            derivative = slope * np.outer(term.at_joints, term.motion)
            if term.at_joints @ term.motion * slope >= 0.0:
                matrix += derivative
            else:
                torque += derivative @ velocity
        return matrix, torque

    def dry_at(self, position: FloatArray, velocity: FloatArray) -> FloatArray:
        """F (m,) [N·m] at a state (n,)."""
        if not self._further_dry:
            return self.dry
        limits, conditions = self.dry.copy(), self._inverse.conditions(position[:, None], self._kelvin)
        for place, term in self._further_dry:
            speed = np.array([max(abs(float(term.motion @ velocity)), SLOPE_SPEED)])
            share = float(term.at_joints @ term.motion / (term.motion @ term.motion))
            at_place = replace(conditions, position=(term.motion @ position)[None, None])
            limits[place] += share * float(self._signal(term, speed, at_place)[0])
        return np.asarray(np.maximum(limits, 0.0))

    def _signal(self, term: _Term, speed: FloatArray, conditions: FrictionConditions) -> FloatArray:
        """The term's signal (1,) at a positive speed (1,) along its motion, at the position (1, 1) along it."""
        signal = column_signal(self._unsmoothed, term.column, speed[None], speed[None], conditions)
        return np.asarray(signal, dtype=np.float64)

    def bias(self, position: FloatArray, velocity: FloatArray) -> FloatArray:
        """B (n,) [N·m]: gravity, Coriolis and centrifugal torque, offsets and torque ripple."""
        total = self.steady(position)
        for arm, sign in self._arms:
            total += sign * arm.bias(position, velocity)
        return total

    def steady(self, position: FloatArray) -> FloatArray:
        """Offsets and torque ripple (n,) [N·m]."""
        total = self.offset.copy()
        for term in self._ripple:
            at_place = FrictionConditions(position=(term.motion @ position)[None, None])
            total += term.at_joints * float(self._signal(term, np.zeros(1), at_place)[0])
        return total

    @property
    def changing_friction(self) -> bool:
        """Return whether anything but linear viscous friction that brakes, Coulomb friction and offsets is there."""
        return bool(self._smooth or self._further_dry or self._ripple or self._accelerating.any())


def _inertial(inverse: InverseDynamics) -> tuple[FloatArray, FloatArray]:
    """Parameters (10·links,) of links that all have a mass, and those of the point masses in them."""
    massive, extra = with_masses(inverse.model, inverse.base, inverse.parameters)
    points = np.zeros_like(massive)
    for link, mass in extra.items():
        points[len(INERTIAL) * link + INERTIAL.index("M")] = mass
    return massive, points


def _check_dissipative(model: DynamicModel, directions: FloatArray, dry: FloatArray) -> None:
    joints = [(int(np.argmax(np.abs(motion))), value) for motion, value in zip(directions, dry, strict=True)]
    wrong = [
        f"{model.joint_names[joint]} ({value:.3g} {joint_unit('N·m', sliding=model.sliding[joint])})"
        for joint, value in joints
        if value < 0.0
    ]
    if wrong:
        raise ModelError(
            f"negative Coulomb friction (not dissipative) of {', '.join(wrong)}: a joint at rest would not stay at "
            "rest",
            where=model.name,
            hint='simulate the physically consistent model (parameters="consistent", the default)',
        )
