"""Columns of the regressor that belong to no link: motor inertia, friction and offset (SR400 eq. 6-8; AUBO eq. 3-6).

Each is one signal of the motion, put into one motor's row, or into several for the friction of a coupled pair. For a
motor that several joints move, inertia and friction follow the motor: Ia on q̈m, Fvm on q̇m, Fsm on sign(q̇m), q̇m = R·q̇,
and so do the further terms of `ident.friction.table`, with the motor's load torque and temperature.
The joint's own friction beside it follows eq. 8 as printed: of joint j, the torque Fs·sign(q̇_j) + Fv·q̇_j counts
negative at the motor of that joint and positive at the one that it turns with (rows −R⁻ᵀ·e_j). With these signs
friction that brakes has negative values, as Fs6 in Table 4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.core.arrays import FloatArray, IndexArray
from drivers.core.errors import ModelError
from ident.friction.table import Operands, Term, signal_of, slope_of, term_of
from ident.friction.terms import FrictionConditions
from ident.model.dynamic_model import DynamicModel
from ident.model.parameters import PAIR_SYMBOLS, StandardParameter

NO_CONDITIONS = FrictionConditions()
"""Conditions of friction that depends on the velocity alone."""


@dataclass(frozen=True)
class JointColumn:
    """One column beside the links'."""

    quantity: str  # its signal: acceleration, velocity, its sign, 1, or a further friction term
    motion: tuple[tuple[int, float], ...]  # (joint, factor) of the active joints whose motion it follows; Σ factor · q̇
    rows: tuple[tuple[int, float], ...]  # (motor, factor) of the rows that it acts on
    # of the signal: exponent of |q̇| or of the load torque, Stribeck velocity [rad/s or m/s], or number of periods per
    # turn
    shape: float = 1.0


def joint_column(model: DynamicModel, parameter: StandardParameter) -> JointColumn:
    """Return where a joint parameter acts, and on what; of an inertial parameter it has no meaning."""
    transmission = model.transmission
    motor = transmission.active.index(parameter.joint)
    if parameter.kind != "coupling":
        motion, shape = _entries(transmission.coupling[motor]), _shape(model, parameter.kind, motor)
        return JointColumn(quantity_of(parameter), motion, ((motor, 1.0),), shape)
    shares = transmission.joint_to_motor[:, motor]
    sign = 1.0 if parameter.symbol == "Iac" else -1.0
    return JointColumn(quantity_of(parameter), ((motor, 1.0),), _entries(sign * shares))


@dataclass(frozen=True)
class AlikeColumns:
    """Friction columns of one kind and shape, each of a motor on its own joint: their signals are one array."""

    column: JointColumn  # the first of them
    motions: tuple[tuple[tuple[int, float], ...], ...]  # of each
    joints: IndexArray  # (k,) whose motion each follows, and the row that it acts on
    values: FloatArray  # (k, 1) of their parameters

    def torques(self, model: DynamicModel, velocity: FloatArray, conditions: FrictionConditions) -> FloatArray:
        """Return what they add (k, m) to the motors' torques, for joint velocities (n, m)."""
        rate = velocity[self.joints]
        direction = None
        if term_of(self.column.quantity).dry:
            direction = model.coulomb_direction(rate)
            for row, motion in enumerate(self.motions):
                if (state := conditions.presliding.get(motion)) is not None:
                    direction[row] = state
        signal = signal_of(self.column.quantity)(Operands(rate, direction, self.column.shape))
        return np.asarray(self.values * signal)


def alike(columns: Sequence[tuple[JointColumn, float]]) -> tuple[list[AlikeColumns], list[tuple[JointColumn, float]]]:
    """Friction columns with their values: those that can be evaluated together, and the others."""
    groups: dict[tuple[str, float], list[tuple[JointColumn, float]]] = {}
    others = []
    for column, value in columns:
        if column.quantity == "motor_inertia":
            continue
        own = len(column.rows) == 1 and column.motion == column.rows == ((column.rows[0][0], 1.0),)
        if own and not term_of(column.quantity).needs:
            groups.setdefault((column.quantity, column.shape), []).append((column, value))
        else:
            others.append((column, value))
    return [
        AlikeColumns(
            group[0][0],
            tuple(column.motion for column, _ in group),
            np.array([column.rows[0][0] for column, _ in group]),
            np.array([[value] for _, value in group]),
        )
        for group in groups.values()
    ], others


def combined(motion: Sequence[tuple[int, float]], signal: FloatArray) -> FloatArray:
    """Σ factor · signal (…,) of the joints in `motion`, from velocities or accelerations (a, …)."""
    (joint, factor), *others = motion
    total: FloatArray = signal[joint] if factor == 1.0 else factor * signal[joint]
    for joint, factor in others:
        total = total + factor * signal[joint]
    return total


def column_signal(
    model: DynamicModel,
    column: JointColumn,
    velocity: FloatArray,
    acceleration: FloatArray,
    conditions: FrictionConditions = NO_CONDITIONS,
) -> FloatArray | float:
    """The column's signal (m,) for active velocities and accelerations (a, m); a number where it is constant.

    Raises:
        ModelError: the signal depends on a load torque, a temperature or a position that `conditions` lacks.
    """
    if column.quantity == "motor_inertia":
        return combined(column.motion, acceleration)
    term = term_of(column.quantity)
    rate = combined(column.motion, velocity)
    direction = _direction(model, column, rate, conditions) if term.dry else None
    at = _with_needed(model, term, column, conditions, Operands(rate, direction, column.shape))
    signal: FloatArray | float = signal_of(column.quantity)(at)
    return signal


def _direction(
    model: DynamicModel, column: JointColumn, rate: FloatArray, conditions: FrictionConditions
) -> FloatArray:
    """sign(q̇) (m,), or the presliding state (…, m) where there is one."""
    state = conditions.presliding.get(column.motion)
    return model.coulomb_direction(rate) if state is None else state


def _with_needed(
    model: DynamicModel, term: Term, column: JointColumn, conditions: FrictionConditions, at: Operands
) -> Operands:
    """The operands with load torque, temperature or position (m,) of the column's motor where its term depends on it.

    Raises:
        ModelError: `conditions` lacks it.
    """
    motor = column.rows[0][0]
    if term.needs == "load":
        if conditions.load_torque is None:
            raise _lacking(model, motor, "the position, which its load-dependent friction follows")
        return replace(at, load=conditions.load_torque[motor])
    if term.needs == "temperature":
        if conditions.temperature is None:
            raise _lacking(model, motor, "its temperature, which its friction depends on")
        return replace(at, kelvin=conditions.temperature[motor])
    if term.needs == "position":
        if conditions.position is None:
            raise _lacking(model, motor, "the position, which its friction depends on")
        return replace(at, angle=combined(column.motion, conditions.position))
    return at


def _lacking(model: DynamicModel, motor: int, what: str) -> ModelError:
    return ModelError(f"{model.joint_names[motor]} lacks {what}", where=model.name, hint="give it with the motion")


def column_slope(
    model: DynamicModel, column: JointColumn, velocity: FloatArray, conditions: FrictionConditions = NO_CONDITIONS
) -> FloatArray | float:
    """Derivative (m,) of a friction column's signal by the velocity that it follows; sign(q̇) counts as constant.

    Below `SLOWEST`, the unbounded slopes of |q̇|^α and √|q̇| are those at that speed.
    """
    if column.quantity == "motor_inertia":
        return 0.0
    term = term_of(column.quantity)
    rate = combined(column.motion, velocity)
    direction_slope: FloatArray | float = 0.0
    if model.smoothing > 0:
        direction_slope = (1.0 - np.tanh(rate / model.smoothing) ** 2) / model.smoothing
    at = Operands(
        rate, model.coulomb_direction(rate) if term.dry else None, column.shape, direction_slope=direction_slope
    )
    at = _with_needed(model, term, column, conditions, at)
    slope: FloatArray | float = slope_of(column.quantity)(at)
    return slope


def _shape(model: DynamicModel, kind: str, motor: int) -> float:
    return 1.0 if kind == "motor_inertia" else model.terms.shape_of(kind, motor)


def quantity_of(parameter: StandardParameter) -> str:
    """Return what a joint parameter's column follows.

    Raises:
        ValueError: it is a link's.
    """
    if parameter.kind == "coupling":
        return PAIR_SYMBOLS[parameter.symbol]
    if parameter.kind == "inertial":
        raise ValueError(f"{parameter.name} is a link's")
    return parameter.kind


def _entries(values: FloatArray) -> tuple[tuple[int, float], ...]:
    return tuple((joint, value) for joint, value in enumerate(values.tolist()) if value)


def own_column(model: DynamicModel, columns: Sequence[int], kind: str, motor: int) -> int | None:
    """Place among standard `columns` of a motor's own parameter of a kind; None where it is not among them."""
    standard, joint = model.parameters, model.active[motor]
    places = (
        place
        for place, column in enumerate(columns)
        if standard[column].kind == kind and standard[column].joint == joint
    )
    return next(places, None)
