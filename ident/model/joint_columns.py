"""Columns of the regressor that are no link's: motor inertia, friction and offset (SR400 eq. 6-8).

Each is one signal of the motion, put into one motor's row, or into several for the friction of a coupled pair. For a
motor that several joints move, inertia and friction follow the motor: Ia on q̈m, Fvm on q̇m, Fsm on sign(q̇m), q̇m = R·q̇.
The joint's own friction beside it follows eq. 8 as printed: of joint j, the torque Fs·sign(q̇_j) + Fv·q̇_j counts
negative at the motor of that joint and positive at the one that it turns with (rows −R⁻ᵀ·e_j). With these signs
friction that brakes has negative values, as Fs6 in Table 4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.streams import FloatArray
from ident.model.dynamic_model import DynamicModel
from ident.model.parameters import PAIR_SYMBOLS, Quantity, StandardParameter


@dataclass(frozen=True)
class JointColumn:
    """One column beside the links'.

    Attributes:
        quantity: its signal: acceleration, velocity, its sign, or 1.
        motion: (joint, factor) of the active joints whose motion it follows; Σ factor · q̇.
        rows: (motor, factor) of the rows that it acts on.
    """

    quantity: Quantity
    motion: tuple[tuple[int, float], ...]
    rows: tuple[tuple[int, float], ...]


def joint_column(model: DynamicModel, parameter: StandardParameter) -> JointColumn:
    """Where a joint parameter acts, and on what; of an inertial parameter it has no meaning."""
    transmission = model.transmission
    if transmission is None:
        own = ((parameter.joint, 1.0),)
        return JointColumn(_quantity(parameter), own, own)
    motor = transmission.active.index(parameter.joint)
    if parameter.kind != "coupling":
        return JointColumn(_quantity(parameter), _entries(transmission.coupling[motor]), ((motor, 1.0),))
    shares = transmission.joint_to_motor[:, motor]
    sign = 1.0 if parameter.symbol == "Iac" else -1.0
    return JointColumn(_quantity(parameter), ((motor, 1.0),), _entries(sign * shares))


def combined(motion: Sequence[tuple[int, float]], signal: FloatArray) -> FloatArray:
    """Σ factor · signal (…,) of the joints in `motion`, from velocities or accelerations (a, …)."""
    (joint, factor), *others = motion
    total: FloatArray = signal[joint] if factor == 1.0 else factor * signal[joint]
    for joint, factor in others:
        total = total + factor * signal[joint]
    return total


def column_signal(
    model: DynamicModel, column: JointColumn, velocity: FloatArray, acceleration: FloatArray
) -> FloatArray | float:
    """The column's signal (m,) for active velocities and accelerations (a, m); a number where it is constant."""
    if column.quantity == "motor_inertia":
        return combined(column.motion, acceleration)
    if column.quantity == "viscous":
        return combined(column.motion, velocity)
    if column.quantity == "coulomb":
        return model.coulomb_direction(combined(column.motion, velocity))
    return 1.0


def _quantity(parameter: StandardParameter) -> Quantity:
    if parameter.kind == "coupling":
        return PAIR_SYMBOLS[parameter.symbol]
    if parameter.kind == "inertial":
        raise ValueError(f"{parameter.name} is a link's")
    return parameter.kind


def _entries(values: FloatArray) -> tuple[tuple[int, float], ...]:
    return tuple((int(joint), float(values[joint])) for joint in np.flatnonzero(values))
