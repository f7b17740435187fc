"""Presliding: a state along the motion in place of sign(q̇) in dry friction, for velocity reversals.

A joint that reverses first deflects its contacts: friction changes sign over a short travel, not at once. Dahl's model
(Dahl, The Aerospace Corporation TOR-0158, 1968; LuGre without damping and with a constant bristle length) has a state
z with dz/dx = (1 − z·sign(ẋ))/δ: after a reversal it goes from one sign to the other as 1 − 2·exp(−x/δ). It multiplies
all terms that do not vanish at rest (Coulomb, Stribeck, load). δ is the pre-sliding travel, one per motion that rubs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from drivers.core.arrays import FloatArray
from ident.friction.table import DRY_KINDS
from ident.friction.terms import NO_STATES, FrictionConditions, Motion, States
from ident.model.base_parameters import BaseParameters
from ident.model.dynamic_model import DynamicModel
from ident.model.joint_columns import JointColumn, column_signal, combined, joint_column
from ident.model.regressor import LoadTorqueKernel


def dahl_states(
    velocity: FloatArray, rate: float, travels: Sequence[float] | FloatArray, start: float | None = None
) -> FloatArray:
    """Dahl's state z (T, N), exact for a velocity that is constant between samples.

    Args:
        velocity: (N,) on a uniform grid [rad/s or m/s].
        rate: [Hz].
        travels: (T,) δ [rad or m], positive.
        start: the state before the first sample. None: that of sliding where the joint moves at first, else 0, as the
            friction that holds a joint at rest may have either sign.
    """
    scale = 1.0 / (rate * np.asarray(travels, dtype=np.float64)[:, None])
    sign, distance = np.sign(velocity), np.abs(velocity)
    states = np.empty((len(scale), len(velocity)))
    state = np.full((len(scale), 1), sign[:1].sum() if start is None else start)
    edges = [0, *(np.flatnonzero(np.diff(sign)) + 1).tolist(), len(sign)]
    for start, stop in pairwise(edges):
        if stop > start:
            decay = np.exp(-np.cumsum(distance[start:stop]) * scale)
            states[:, start:stop] = sign[start] + (state - sign[start]) * decay
            state = states[:, stop - 1 : stop]
    return states


def dahl_steps(displacement: FloatArray, travels: FloatArray, state: FloatArray) -> FloatArray:
    """Dahl's states (m, N) of m motions after each of the displacements (m, N) [rad or m], from states (m,) on.

    Args:
        displacement: (m, N) between samples.
        travels: (m,) δ [rad or m], positive.
        state: (m,) before.
    """
    decay = np.exp(-np.abs(displacement) / travels[:, None])
    aim = np.sign(displacement) * (1.0 - decay)
    states = np.empty_like(displacement)
    for sample in range(displacement.shape[1]):
        state = states[:, sample] = decay[:, sample] * state + aim[:, sample]
    return states


def presliding_states(model: DynamicModel, velocity: FloatArray, rate: float) -> States:
    """Dahl's state (N,) of each motion of the model that has a travel, along velocities (n, N) on a uniform grid."""
    if not model.presliding:
        return NO_STATES
    return {
        motion: dahl_states(combined(motion, velocity), rate, [travel])[0]
        for motion, travel in presliding_motions(model).items()
    }


def presliding_motions(model: DynamicModel) -> dict[Motion, float]:
    """The motions that have a pre-sliding travel [rad or m]."""
    standard = {parameter.name: parameter for parameter in model.parameters} if model.presliding else {}
    return {joint_column(model, standard[name]).motion: travel for name, travel in model.presliding}


@dataclass(frozen=True)
class DryFriction:
    """Columns of an arm's dry friction with their values."""

    model: DynamicModel  # the arm
    # (column, value) of each motion that rubs, by the name of its Coulomb parameter
    columns: dict[str, tuple[tuple[JointColumn, float], ...]]

    def motors(self, name: str) -> list[int]:
        """Motors (k,) that the dry friction of this Coulomb parameter's motion acts on."""
        return sorted({motor for column, _ in self.columns[name] for motor, _ in column.rows})

    def conditions(self, position: FloatArray) -> FrictionConditions:
        """Return what the static friction depends on at positions (n, N) [rad or m]."""
        return FrictionConditions(
            LoadTorqueKernel(self.model).torque(position) if self.model.needs_load_torque else None, position=position
        )

    def change(
        self,
        name: str,
        travels: Sequence[float] | FloatArray,
        velocity: FloatArray,
        rate: float,
        conditions: FrictionConditions,
    ) -> FloatArray:
        """Changes (T, k, N) [N·m or N] of the torques of `motors(name)` by presliding, for T travels.

        Args:
            name: of the Coulomb parameter.
            travels: (T,) [rad or m].
            velocity: (n, N) on a uniform grid [rad/s or m/s].
            rate: [Hz].
            conditions: of the static friction along the motion.
        """
        columns, motors = self.columns[name], self.motors(name)
        motion = columns[0][0].motion
        states = {motion: dahl_states(combined(motion, velocity), rate, travels)}
        sliding = replace(conditions, presliding=states)
        change = np.zeros((len(travels), len(motors), velocity.shape[1]))
        for column, value in columns:
            with_state, static = (
                column_signal(self.model, column, velocity, velocity, given) for given in (sliding, conditions)
            )
            for motor, factor in column.rows:
                change[:, motors.index(motor)] += factor * value * (with_state - static)
        return change

    def torque_change(
        self, travels: Mapping[str, float], position: FloatArray, velocity: FloatArray, rate: float
    ) -> FloatArray:
        """The same (n, N) of all motors, for the travel of each Coulomb parameter that has one."""
        total, conditions = np.zeros_like(velocity), self.conditions(position)
        for name in travels.keys() & self.columns.keys():
            total[self.motors(name)] += self.change(name, [travels[name]], velocity, rate, conditions)[0]
        return total


def dry_friction(model: DynamicModel, base: BaseParameters, parameters: FloatArray) -> DryFriction:
    """The dry friction of base parameters (b,); those without a value (nan) have none."""
    given = [
        (name, joint_column(model, model.parameters[column]), float(value))
        for name, column, value in zip(base.names, base.columns, parameters, strict=True)
        if model.parameters[column].kind != "inertial" and np.isfinite(value)
    ]
    names: dict[Motion, str] = {}
    for name, column, _ in given:
        if column.quantity == "coulomb":
            names.setdefault(column.motion, name)
    return DryFriction(
        model,
        {
            name: tuple(
                (column, value)
                for _, column, value in given
                if column.motion == motion and column.quantity in DRY_KINDS
            )
            for motion, name in names.items()
        },
    )
