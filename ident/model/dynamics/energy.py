"""The energy of an arm, linear in its standard parameters (SR400 eq. 10 and 11): no accelerations.

With ω and v the angular velocity of a link's frame and the velocity of its origin, both in its axes, p the origin in
the base frame and R the frame's rotation, a link of inertia I, first moments h and mass M has

    ½·ωᵀIω + v·(ω × h) + ½·M·v²  −  gᵀ(M·p + R·h)

and a motor ½·Ia·q̇². What is not stored is lost to friction, whose power is Fv·q̇² + Fs·|q̇| + Fo·q̇. Along any motion

    d/dt(energy) + friction power = q̇ᵀτ

Only Rᵀg and gᵀp are needed of the potential energy, so the recursion carries those instead of R and p. With closed
loops or coupled motors the energy is that of the tree's links at the positions and velocities that the joints with a
motor impose, and the work is that of the motors, q̇mᵀτ with q̇m = R·q̇ (SR400 eq. 10).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from drivers.core.arrays import FloatArray
from ident.friction.terms import FrictionConditions
from ident.linear_algebra.triangular import triangular
from ident.linear_algebra.vectors import cross
from ident.model.base_parameters import (
    RANDOM_SEED,
    BaseParameters,
    ModelKey,
    base_parameters_of,
    random_states,
    random_temperature,
)
from ident.model.dynamic_model import DynamicModel
from ident.model.joint_columns import JointColumn, column_signal, combined, joint_column
from ident.model.kinematics.joints import BASE_INDEX, Joint
from ident.model.newton_euler import rotation_coefficients
from ident.model.regressor import LoadTorqueKernel

STATES_AT_ONCE = 4096
"""States evaluated at once."""

WINDOWS_PER_PARAMETER = 20
"""Random windows a standard parameter from which the rank of the energy model is decided."""


@dataclass(frozen=True)
class _LinkState:
    """One link's motion in its own frame; ω, v, Rᵀg are (3, m), gᵀp is (m,)."""

    angular: FloatArray
    linear: FloatArray
    gravity: FloatArray
    height: FloatArray


class EnergyKernel:
    """Evaluates chosen columns of the energy regressor h(q, q̇) and of the friction powers.

    Attributes:
        model: whose energy this is.
        columns: standard columns in the order of the caller's choice.
        friction_rows: which of them are friction's, viscous, Coulomb or offset.
    """

    def __init__(self, model: DynamicModel, columns: Sequence[int] | None = None) -> None:
        """Prepare an arm and some standard columns; all of them where None."""
        self.model = model
        parameters = model.parameters
        self.columns = tuple(range(len(parameters))) if columns is None else tuple(columns)
        self._turns = [rotation_coefficients(joint) for joint in model.joints]
        self._inertial: dict[int, list[tuple[int, str]]] = {}
        self._motors: list[tuple[int, JointColumn, float]] = []
        self._friction: list[tuple[int, JointColumn, float]] = []
        for row, index in enumerate(self.columns):
            parameter = parameters[index]
            if parameter.kind == "inertial":
                self._inertial.setdefault(parameter.joint, []).append((row, parameter.symbol))
                continue
            acting = joint_column(model, parameter)
            entries = self._motors if acting.quantity == "motor_inertia" else self._friction
            entries.append((row, acting, _power_sign(model, acting)))
        self.friction_rows = [row for row, _, _ in self._friction]
        self._load = LoadTorqueKernel(model) if model.needs_load_torque else None

    def energy(self, position: FloatArray, velocity: FloatArray) -> FloatArray:
        """Stored energy (b, N) [J] of unit parameters at states (n, N); zero in the rows of friction.

        Args:
            position: (n, N) of the joints with a motor [rad or m].
            velocity: (n, N) [rad/s or m/s].
        """
        out = np.zeros((len(self.columns), position.shape[1]))
        for start in range(0, position.shape[1], STATES_AT_ONCE):
            chunk = slice(start, start + STATES_AT_ONCE)
            self._fill(position[:, chunk], velocity[:, chunk], out[:, chunk])
        return out

    def friction_power(
        self, velocity: FloatArray, position: FloatArray | None = None, temperature: FloatArray | None = None
    ) -> FloatArray:
        """Power (f, N) [W] lost to friction of unit coefficients, in order of `friction_rows`.

        Args:
            velocity: (n, N) of the joints with a motor [rad/s or m/s].
            position: (n, N) [rad or m], where friction depends on it or on the load.
            temperature: (n, N) [K], where friction depends on it.
        """
        load = None if self._load is None or position is None else self._load.torque(position)
        conditions = FrictionConditions(load, temperature, position=position)
        out = np.empty((len(self.friction_rows), velocity.shape[1]))
        for (_, column, sign), power in zip(self._friction, out, strict=True):
            rate = combined(column.motion, velocity)
            np.multiply(rate, sign * column_signal(self.model, column, velocity, velocity, conditions), out=power)
        return out

    def _fill(self, position: FloatArray, velocity: FloatArray, out: FloatArray) -> None:
        states: list[_LinkState] = []
        tree_position, tree_rate = self.model.tree_velocity(position, velocity)
        for index, joint in enumerate(self.model.joints):
            states.append(self._state(index, joint, tree_position[index], tree_rate[index], states))
            if index in self._inertial:
                of_link = _link_columns(states[index])
                for row, symbol in self._inertial[index]:
                    out[row] = of_link[symbol]
        for row, column, sign in self._motors:
            out[row] = 0.5 * sign * combined(column.motion, velocity) ** 2

    def _state(
        self, index: int, joint: Joint, position: FloatArray, velocity: FloatArray, states: Sequence[_LinkState]
    ) -> _LinkState:
        count = len(position)
        offset = np.repeat(joint.translation[:, None], count, axis=1)
        if joint.prismatic:
            offset += (joint.rotation @ joint.axis)[:, None] * position
        if joint.parent == BASE_INDEX:
            angular, linear = np.zeros((3, count)), np.zeros((3, count))
            gravity = np.repeat(self.model.gravity[:, None], count, axis=1)
            height = self.model.gravity @ offset
        else:
            parent = states[joint.parent]
            angular, gravity = parent.angular, parent.gravity
            linear = parent.linear + cross(angular, offset)
            height = parent.height + (gravity * offset).sum(axis=0)
        constant, sine, cosine = self._turns[index]
        turn = constant[:, :, None] + sine[:, :, None] * np.sin(position) + cosine[:, :, None] * np.cos(position)
        angular, linear, gravity = (np.einsum("ijm,jm->im", turn, vector) for vector in (angular, linear, gravity))
        own = joint.axis[:, None] * velocity
        if joint.prismatic:
            return _LinkState(angular, linear + own, gravity, height)
        return _LinkState(angular + own, linear, gravity, height)


def motor_velocity(model: DynamicModel, velocity: FloatArray) -> FloatArray:
    """Velocities (n, N) of the motors, referred to the joint side, for those of the joints with a motor."""
    return model.transmission.motor_rate(velocity)


def _power_sign(model: DynamicModel, column: JointColumn) -> float:
    """Power of a column over its signal times its motion's velocity: 1, or -1 where its torque is defined so."""
    torque = np.zeros(model.dof)
    for motor, factor in column.rows:
        torque[motor] += factor
    joints = model.transmission.at_joints(torque)
    motion = np.zeros(model.dof)
    for joint, factor in column.motion:
        motion[joint] += factor
    return float(joints @ motion / (motion @ motion))


def _link_columns(state: _LinkState) -> dict[str, FloatArray]:
    """Energy (m,) of each unit parameter of a link, by symbol."""
    x, y, z = state.angular
    moment = cross(state.linear, state.angular) - state.gravity
    return {
        "XX": 0.5 * x * x,
        "XY": x * y,
        "XZ": x * z,
        "YY": 0.5 * y * y,
        "YZ": y * z,
        "ZZ": 0.5 * z * z,
        "MX": moment[0],
        "MY": moment[1],
        "MZ": moment[2],
        "M": 0.5 * (state.linear**2).sum(axis=0) - state.height,
    }


def energy_base_parameters(model: DynamicModel) -> BaseParameters:
    """Base parameters of the energy model: those identifiable from differences of energy and friction losses.

    In theory they are those of the dynamic model: a combination whose power q̇ᵀτ is zero at every state has no inertia,
    no gravity and no friction, so no torque either. Here the rank is decided from the energy regressor itself.

    Raises:
        IdentificationError: the rank cannot be decided.
    """
    return _cached(ModelKey(model))


@lru_cache(maxsize=32)
def _cached(key: ModelKey) -> BaseParameters:
    model = key.model
    return base_parameters_of(model, triangular(random_windows(model).T))


def random_windows(model: DynamicModel) -> FloatArray:
    """Energy regressor (p, r) over random windows: from one random state to another, in one second.

    The friction's work depends on the path. It is drawn at random too: each half of the second at one velocity, the two
    so that the joint reaches its end position, on which alone an offset's work depends.
    """
    kernel = EnergyKernel(model)
    count = WINDOWS_PER_PARAMETER * len(kernel.columns)
    position, velocity, _ = random_states(model, 2 * count)
    _, detour, _ = random_states(model, count, seed=RANDOM_SEED + 1)
    stored = kernel.energy(position, velocity)
    rows = stored[:, count:] - stored[:, :count]
    direct = position[:, count:] - position[:, :count]
    heat = random_temperature(model, count)
    for rate in (direct + detour, direct - detour):
        rows[kernel.friction_rows] += 0.5 * kernel.friction_power(rate, position[:, :count], heat)
    return rows
