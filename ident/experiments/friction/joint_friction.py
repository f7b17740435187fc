"""Friction of one joint as an experiment finds it, and its torque."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from ident.friction.table import TERM
from ident.friction.terms import FrictionConditions, FrictionTerms
from ident.model.dynamic_model import DynamicModel
from ident.model.joint_columns import JointColumn, column_signal
from ident.result.friction import FrictionStep
from ident.result.friction_experiment import JointFrictionExperiment

ALONE = ((0, 1.0),)
"""Motion and row of the column of a joint by itself."""


@dataclass(frozen=True, eq=False)
class JointExperiment:
    """Friction of one joint, and what its page shows beside.

    Attributes:
        stored: what friction.json holds of it.
        terms: of this one motor, shapes as estimated.
        steps: terms that were tried.
        points: (4, P) velocity, temperature [K] (nan where unknown), load torque, measured friction.
    """

    stored: JointFrictionExperiment
    terms: FrictionTerms
    steps: tuple[FrictionStep, ...]
    points: FloatArray


def friction_signal(
    model: DynamicModel, kind: str, shape: float, velocity: FloatArray, conditions: FrictionConditions
) -> FloatArray:
    """Signal (N,) of a friction column of one joint.

    Args:
        model: says how the sign of the velocity is smoothed.
        kind: of the column.
        shape: exponent or Stribeck velocity.
        velocity: (N,) [rad/s or m/s].
        conditions: load torque and temperature, (1, N) each.
    """
    column = JointColumn(kind, ALONE, ALONE, shape)
    signal = column_signal(model, column, velocity[None], np.zeros_like(velocity)[None], conditions)
    return np.broadcast_to(np.asarray(signal), velocity.shape)


def friction_torque(
    model: DynamicModel, joint: JointExperiment, velocity: FloatArray, kelvin: FloatArray, load: FloatArray
) -> FloatArray:
    """Friction torque (N,) of a joint at velocities, temperatures [K] and load torques (N,)."""
    conditions = FrictionConditions(load[None], kelvin[None])
    total = np.zeros_like(velocity)
    for kind, value in zip(joint.stored.kinds, joint.stored.values, strict=True):
        if kind in TERM:
            signal = friction_signal(model, kind, joint.terms.shape_of(kind, 0), velocity, conditions)
            total = total + value * signal
    return total
