"""Friction from an experiment (`dynid friction`): its terms and shapes, and values that a recording cannot tell.

The terms and shapes (α, v_s, power of the load) of the experiment hold for the identification. A joint's temperature
terms need temperatures that differ; where those of the recordings do not, its values from the experiment are held: the
torque that they make is taken off the measured one before the regression (AUBO eq. 8), and is in the model after it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError, UsageError
from drivers.core.text import did_you_mean
from ident.friction.table import FURTHER_KINDS, LEAST_CURVATURE_SPAN, LEAST_TEMPERATURE_SPAN, SHAPES, TEMPERATURE_KINDS
from ident.friction.terms import FrictionConditions, FrictionTerms, no_terms
from ident.model.dynamic_model import DynamicModel
from ident.model.joint_columns import column_signal, joint_column
from ident.model.parameters import JOINT_SYMBOLS, StandardParameter
from ident.signals.prepared import Prepared, Segment, Step

if TYPE_CHECKING:
    from ident.result.friction_experiment import FrictionExperimentResult, JointFrictionExperiment


@dataclass(frozen=True, eq=False)
class HeldJoint:
    """Temperature terms of one motor, m coefficients."""

    motor: int  # its index
    kinds: tuple[str, ...]  # of the columns
    values: FloatArray  # (m,)
    covariance: FloatArray  # (m, m) by the experiment
    span: float  # of the recordings' temperatures [K]


@dataclass(frozen=True, eq=False)
class HeldFriction:
    """What an identification holds at the experiment's values."""

    model: DynamicModel  # with all terms of the experiment
    joints: tuple[HeldJoint, ...]  # whose temperature terms are held, the others estimated
    text: str  # which, in words

    def torque(self, segment: Segment) -> FloatArray:
        """Friction torque (n, N) of the motors by the held terms."""
        total = np.zeros_like(segment.torque)
        conditions = FrictionConditions(None, segment.temperature)
        for joint in self.joints:
            for kind, value in zip(joint.kinds, joint.values.tolist(), strict=True):
                column = joint_column(self.model, parameter_of(self.model, joint.motor, kind))
                signal = column_signal(self.model, column, segment.velocity, segment.acceleration, conditions)
                for motor, factor in column.rows:
                    total[motor] += factor * value * signal
        return total

    def taken_off(self, prepared: Prepared) -> Prepared:
        """The same data without the torque of the held terms."""
        if not self.joints:
            return prepared
        segments = []
        for segment in prepared.segments:
            held = self.torque(segment)
            segments.append(replace(segment, torque=segment.torque - held, known_torque=held))
        step = Step("friction held", {"joints": len(self.joints)}, self.text)
        return replace(prepared, segments=tuple(segments), steps=(*prepared.steps, step))


def parameter_of(model: DynamicModel, motor: int, kind: str) -> StandardParameter:
    """The standard parameter of a motor's friction."""
    joint, symbol = model.active[motor], JOINT_SYMBOLS[kind]
    return StandardParameter(f"{symbol}{joint + 1}", kind, joint, symbol)


def experiment_terms(experiment: FrictionExperimentResult, robot: str, names: Sequence[str]) -> FrictionTerms:
    """Terms of all motors, shapes fixed; joints without an experiment have none beside Coulomb and viscous friction.

    Raises:
        UsageError: the experiment is another robot's.
    """
    where = "--friction-from"
    if experiment.robot != robot:
        raise UsageError(f"the friction experiment is of {experiment.robot}, the recording of {robot}", where=where)
    for joint in experiment.joints:
        if joint.joint not in names:
            raise UsageError(
                f"no joint of {robot} is called '{joint.joint}'", where=where, hint=did_you_mean(joint.joint, names)
            )
    joints = {joint.joint: joint for joint in experiment.joints}
    measured: list[JointFrictionExperiment | None] = [joints.get(name) for name in names]
    terms = no_terms(len(names))
    for motor, held in enumerate(measured):
        if held is None:
            continue
        terms = terms.with_kinds(motor, [kind for kind in held.kinds if kind in FURTHER_KINDS])
        for name in SHAPES:
            value = held.shape_value(name)
            if value is not None:
                terms = terms.with_shape(name, motor, value)
    return terms


def hold_temperatures(
    model: DynamicModel, experiment: FrictionExperimentResult, temperatures: Sequence[tuple[str, FloatArray | None]]
) -> tuple[DynamicModel, HeldFriction]:
    """The model whose temperature terms the recordings can tell, and those that are held.

    Args:
        model: with the experiment's terms.
        experiment: its values.
        temperatures: of each recording its label and temperatures (N, n) [K].

    Raises:
        DataError: a temperature was not recorded; the experiment does not know the σ of what is to be held.
    """
    for label, kelvin in temperatures:
        model.require_temperature(None if kelvin is None else kelvin.T, label)
    terms = model.terms
    values = {joint.joint: joint for joint in experiment.joints}
    held = []
    for motor, name in enumerate(model.joint_names):
        kinds = tuple(kind for kind in TEMPERATURE_KINDS if terms.asks(kind, motor))
        if not kinds:
            continue
        curved = len(kinds) == len(TEMPERATURE_KINDS)
        of_joint = np.concatenate([kelvin[:, motor] for _, kelvin in temperatures if kelvin is not None])
        span = float(np.ptp(of_joint))
        if span >= (LEAST_CURVATURE_SPAN if curved else LEAST_TEMPERATURE_SPAN):
            continue
        coefficients, covariance = values[name].part(kinds)
        if not np.all(np.isfinite(covariance)) or np.linalg.eigvalsh(covariance)[0] <= 0.0:
            raise DataError(
                f"the experiment has no uncertainty for the temperature terms of {name}",
                where="--friction-from",
                hint="repeat the sweep, and dynid friction",
            )
        held.append(HeldJoint(motor, kinds, coefficients, covariance, span))
    spans = ", ".join(f"{model.joint_names[joint.motor]} {joint.span:.2g} K" for joint in held)
    text = (
        "temperature terms held at the friction experiment's values, since the recordings span too little temperature "
        f"({spans}; {LEAST_TEMPERATURE_SPAN:g} K are needed, with curvature {LEAST_CURVATURE_SPAN:g}): their torque is "
        "taken off before the regression"
        if held
        else "no value of the friction experiment is held, only its terms and shapes"
    )
    kept = terms
    for joint in held:
        kept = kept.with_kinds(joint.motor, (), TEMPERATURE_KINDS)
    return replace(model, terms=kept), HeldFriction(model, tuple(held), text)
