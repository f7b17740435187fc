"""A model without the friction that URDF, MJCF and Pinocchio models cannot hold, and what that was."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drivers.core.arrays import FloatArray
from ident.friction.table import REFERENCE_TEMPERATURE, SHAPED, SHAPES, TERMS
from ident.friction.terms import NO_TERMS, FrictionConditions
from ident.model.base_parameters import random_states
from ident.model.dynamic_model import DynamicModel
from ident.model.joint_columns import column_signal, joint_column
from ident.model.parameters import StandardParameter
from ident.model.regressor import LoadTorqueKernel

SPEEDS = 50
"""Speeds up to a joint's limit at which the nearest Coulomb and viscous friction is found."""

POSES = 200
"""Random poses whose mean load counts."""


def without_further_friction(
    model: DynamicModel, values: FloatArray
) -> tuple[DynamicModel, FloatArray, tuple[str, ...]]:
    """The model with Coulomb, linear viscous friction and offsets only, its standard parameters, and what it lacks.

    Coulomb and viscous friction of a joint with further terms are those nearest to its curve, by least squares over
    speeds up to its limit, at 25 °C and under the mean load of random poses.

    Args:
        model: as identified.
        values: (p,) its standard parameters.
    """
    travels = [name for name, _ in model.presliding]
    gradual = (f"presliding of {', '.join(travels)}: friction changes sign at once",) if travels else ()
    terms = model.terms
    if terms.plain:
        return replace(model, presliding=()), values, gradual
    simple = replace(model, terms=NO_TERMS, presliding=())
    value_of = dict(zip((parameter.name for parameter in model.parameters), values.tolist(), strict=True))
    value_of |= _nearest(model, value_of)
    kept = np.array([value_of[parameter.name] for parameter in simple.parameters])
    names, sentences = model.joint_names, []
    for term in TERMS:
        joints = [name for name, there in zip(names, model.has(term.kind), strict=True) if there and term.left_out]
        if joints:
            sentences.append(f"{term.left_out} of {', '.join(joints)}")
    for shape in SHAPES.values():
        bent = [
            f"{name} {terms.shape(shape.name, motor):.3g}"
            for motor, name in enumerate(names)
            if shape.left_out and model.has(SHAPED[shape.name].kind)[motor] and terms.bent(shape.name, motor)
        ]
        if bent:
            sentences.append(f"{shape.left_out} of {', '.join(bent)}")
    if sentences:
        sentences.append(
            "in their place stands the Coulomb and viscous friction nearest to them up to the joints' limits"
        )
    return simple, kept, (*sentences, *gradual)


def _nearest(model: DynamicModel, value_of: dict[str, float]) -> dict[str, float]:
    """Coulomb and viscous parameters, by name, of the motors whose friction has further terms."""
    load = None
    if model.needs_load_torque:
        loads = LoadTorqueKernel(model).torque(random_states(model, POSES)[0])
        load = np.mean(np.abs(loads), axis=1)
    found: dict[str, float] = {}
    for motor, joint in enumerate(model.active):
        own = [
            parameter
            for parameter in model.parameters
            if parameter.joint == joint and parameter.kind not in ("inertial", "motor_inertia", "offset", "coupling")
        ]
        plain = {parameter.kind: parameter.name for parameter in own if parameter.kind in ("coulomb", "viscous")}
        bent = any(model.terms.shape_of(kind, motor) != 1.0 for kind in plain)
        if not plain or (len(own) == len(plain) and not bent):
            continue
        speed = np.linspace(0.0, model.limits[motor].velocity, SPEEDS + 1)[1:]
        curve = np.sum([value_of[one.name] * _signal(model, one, motor, speed, load) for one in own], axis=0)
        columns = np.column_stack([np.ones_like(speed) if kind == "coulomb" else speed for kind in plain])
        found |= dict(zip(plain.values(), _not_negative(columns, curve), strict=True))
    return found


def _signal(
    model: DynamicModel, parameter: StandardParameter, motor: int, speed: FloatArray, load: FloatArray | None
) -> FloatArray:
    """The signal (m,) of a motor's friction column at positive speeds (m,), alone in motion."""
    column = replace(joint_column(model, parameter), motion=((0, 1.0),))
    loads = None if load is None else np.repeat(load[:, None], len(speed), axis=1)
    heat = np.full((model.dof, len(speed)), REFERENCE_TEMPERATURE)
    conditions = FrictionConditions(loads, heat)
    signal = column_signal(replace(model, smoothing=0.0), column, speed[None], speed[None], conditions)
    return np.broadcast_to(np.asarray(signal, dtype=np.float64), speed.shape)


def _not_negative(columns: FloatArray, curve: FloatArray) -> list[float]:
    """Coefficients of least squares, none below 0."""
    from scipy.optimize import nnls

    return [float(value) for value in nnls(columns, curve)[0]]
