"""What acts at the joints beside the links: motor inertia, friction, offsets, as numbers and as expressions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from ident.export.c_code.expressions import Expression, Graph, cosine, decay, hyperbolic_tangent, power, sign, sine
from ident.export.c_code.frames import combination
from ident.friction.table import DRY_KINDS, TERM, Maths, Operands
from ident.friction.terms import Motion
from ident.model.dynamic_model import DynamicModel
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.model.joint_columns import JointColumn, joint_column
from ident.model.presliding import presliding_motions

EXPRESSIONS = Maths(sign, power, decay, cosine, sine)
"""The functions that friction terms are written with."""


@dataclass(frozen=True)
class JointTermsCode:
    """Torques at the n joints with a motor: inertia·q̈ + viscous·q̇ + Σ coulomb·sign(motion·q̇) + offset + further."""

    inertia: FloatArray  # (n, n) [kg·m²] of the motors
    viscous: FloatArray  # (n, n) [N·m·s/rad]
    coulomb: tuple[tuple[FloatArray, FloatArray], ...]  # (motion (n,), torques (n,) [N·m]) of each Coulomb column
    offset: FloatArray  # (n,) [N·m]
    # (column, motion (n,), torques (n,)) of each other column of friction
    further: tuple[tuple[JointColumn, FloatArray, FloatArray], ...]
    # the same of the dry friction, Coulomb columns included, whose motion has a presliding travel
    sliding: tuple[tuple[JointColumn, FloatArray, FloatArray], ...]


def joint_terms(dynamics: InverseDynamics) -> JointTermsCode:
    """The joint terms of identified parameters."""
    model = dynamics.model
    inertia, viscous = np.zeros((2, model.dof, model.dof))
    offset = np.zeros(model.dof)
    coulomb, further, sliding = [], [], []
    gradual = presliding_motions(model)
    for number, value in zip(dynamics.base.columns, dynamics.parameters, strict=True):
        parameter = model.parameters[number]
        if parameter.kind == "inertial" or value == 0.0:
            continue
        column = joint_column(model, parameter)
        motion, torques = _motion(model, column.motion), float(value) * _rows(dynamics, column)
        if column.motion in gradual and column.quantity in DRY_KINDS:
            sliding.append((column, motion, torques))
        if column.quantity == "motor_inertia":
            inertia += np.outer(torques, motion)
        elif column.quantity == "viscous" and column.shape == 1.0:
            viscous += np.outer(torques, motion)
        elif column.quantity == "coulomb":
            coulomb.append((motion, torques))
        elif column.quantity == "offset":
            offset += torques
        else:
            further.append((column, motion, torques))
    return JointTermsCode(inertia, viscous, tuple(coulomb), offset, tuple(further), tuple(sliding))


def friction(
    graph: Graph,
    terms: JointTermsCode,
    smoothing: float,
    position: Sequence[Expression],
    velocity: Sequence[Expression],
    load_torque: Sequence[Expression],
) -> list[Expression]:
    """Friction and offsets (n,) at the joints' positions and velocities (n,) and the motors' load torques (n,)."""
    totals = [combination(graph, row, velocity) for row in terms.viscous]
    for motion, torques in terms.coulomb:
        direction = coulomb_direction(combination(graph, motion, velocity), smoothing)
        totals = [total + direction * float(torque) for total, torque in zip(totals, torques, strict=True)]
    for column, motion, torques in terms.further:
        angle, rate = (combination(graph, motion, signals) for signals in (position, velocity))
        signal = _further_signal(column, angle, rate, coulomb_direction(rate, smoothing), load_torque)
        totals = [total + signal * float(torque) for total, torque in zip(totals, torques, strict=True)]
    return [total + float(constant) for total, constant in zip(totals, terms.offset, strict=True)]


def presliding_states(
    graph: Graph, model: DynamicModel, velocity: Sequence[Expression], states: Sequence[Expression], time: Expression
) -> tuple[Expression, ...]:
    """Dahl's states (s,) after a time [s] at constant velocities (n,), as `ident.model.presliding.dahl_states`."""
    after = []
    for (motion, travel), state in zip(presliding_motions(model).items(), states, strict=True):
        rate = combination(graph, _motion(model, motion), velocity)
        direction = sign(rate)
        after.append(direction + (state - direction) * decay(direction * rate * time / travel))
    return tuple(after)


def presliding_torque(
    graph: Graph,
    model: DynamicModel,
    terms: JointTermsCode,
    position: Sequence[Expression],
    velocity: Sequence[Expression],
    states: Sequence[Expression],
    load_torque: Sequence[Expression],
) -> tuple[Expression, ...]:
    """Return what Dahl's states (s,) in place of sign(q̇) add to the joints' torques (n,)."""
    by_motion: Mapping[Motion, Expression] = dict(zip(presliding_motions(model), states, strict=True))
    totals = [graph.constant(0.0)] * model.dof
    for column, motion, torques in terms.sliding:
        angle, rate = (combination(graph, motion, signals) for signals in (position, velocity))
        with_state, static = (
            _further_signal(column, angle, rate, direction, load_torque)
            for direction in (by_motion[column.motion], sign(rate))
        )
        change = with_state - static
        totals = [total + change * float(torque) for total, torque in zip(totals, torques, strict=True)]
    return tuple(totals)


def _further_signal(
    column: JointColumn, angle: Expression, rate: Expression, direction: Expression, load_torque: Sequence[Expression]
) -> Expression:
    """Signal of a column of friction at a motor's position and velocity, for its direction of motion."""
    at = Operands(rate, direction, column.shape, load_torque[column.rows[0][0]], maths=EXPRESSIONS, angle=angle)
    signal: Expression = TERM[column.quantity].signal(at)
    return signal


def joint_parameter_column(
    graph: Graph,
    dynamics: InverseDynamics,
    number: int,
    position: Sequence[Expression],
    velocity: Sequence[Expression],
    acceleration: Sequence[Expression],
    load_torque: Sequence[Expression],
) -> list[Expression]:
    """The regressor's column (n,) of a standard parameter that is no link's."""
    model = dynamics.model
    column = joint_column(model, model.parameters[number])
    motion = _motion(model, column.motion)
    if column.quantity == "motor_inertia":
        signal = combination(graph, motion, acceleration)
    elif column.quantity == "viscous" and column.shape == 1.0:
        signal = combination(graph, motion, velocity)
    elif column.quantity == "coulomb":
        signal = coulomb_direction(combination(graph, motion, velocity), model.smoothing)
    elif column.quantity == "offset":
        signal = graph.constant(1.0)
    else:
        angle, rate = (combination(graph, motion, signals) for signals in (position, velocity))
        signal = _further_signal(column, angle, rate, coulomb_direction(rate, model.smoothing), load_torque)
    return [signal * float(factor) for factor in _rows(dynamics, column)]


def coulomb_direction(velocity: Expression, smoothing: float) -> Expression:
    """sign(q̇), or tanh(q̇/ε) where ε [rad/s] is not 0."""
    return hyperbolic_tangent(velocity * (1.0 / smoothing)) if smoothing > 0.0 else sign(velocity)


def _motion(model: DynamicModel, motion: Motion) -> FloatArray:
    factors = np.zeros(model.dof)
    for joint, factor in motion:
        factors[joint] = factor
    return factors


def _rows(dynamics: InverseDynamics, column: JointColumn) -> FloatArray:
    """Torques (n,) at the joints of a unit of the column's signal: Rᵀ times those at the motors."""
    motors = np.zeros(dynamics.model.dof)
    for motor, factor in column.rows:
        motors[motor] = factor
    return np.asarray(dynamics.coupling.T @ motors)
