"""The result with friction that was held at an experiment's values: it predicts with it and says where it is from."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ident.friction.table import temperature_estimate
from ident.friction.terms import no_terms
from ident.identify.held_friction import HeldFriction, HeldJoint, parameter_of
from ident.identify.identification import Identification
from ident.model.dynamic_model import DynamicModel
from ident.regression.observability import experiment_base
from ident.result.consistent_model import ConsistentModel, StandardParameterResult
from ident.result.estimate import EstimateResult
from ident.result.friction import JointFrictionResult
from ident.result.schema import BaseParameterResult, ModelOptions, Result
from ident.result.units import parameter_unit

ORIGIN = "friction experiment"
"""Origin of values that were held."""


def with_held_friction(result: Result, identification: Identification) -> Result:
    """The result with the held coefficients among its parameters; as it is where none were held."""
    held = identification.held
    if held is None or not held.joints:
        return result
    model = _whole_model(identification.model, held)
    entries = [entry for joint in held.joints for entry in _entries(model, identification, joint)]
    order = experiment_base(model, [identification.experiment]).names
    by_name = {entry.name: entry for entry in [*result.base_parameters, *entries]}
    return result.model_copy(
        update={
            "model_options": ModelOptions.model_validate(model, from_attributes=True),
            "base_parameters": [by_name[name] for name in order],
            "friction": _friction(result.friction, held),
            "consistent": None if result.consistent is None else _consistent(result.consistent, entries),
            "estimate": None if result.estimate is None else _estimate(result.estimate, model, held),
        }
    )


def _whole_model(model: DynamicModel, held: HeldFriction) -> DynamicModel:
    """The identified model with all temperature terms."""
    terms = model.terms if model.terms.kinds else no_terms(model.dof)
    for joint in held.joints:
        terms = terms.with_kinds(joint.motor, joint.kinds)
    return replace(model, terms=terms)


def _entries(model: DynamicModel, identification: Identification, joint: HeldJoint) -> list[BaseParameterResult]:
    deviations, entries = np.sqrt(np.diag(joint.covariance)), []
    columns = {parameter.name: index for index, parameter in enumerate(model.parameters)}
    for kind, value, std in zip(joint.kinds, joint.values.tolist(), deviations.tolist(), strict=True):
        parameter = parameter_of(model, joint.motor, kind)
        relative = 100.0 * std / abs(value) if value else None
        entries.append(
            BaseParameterResult(
                name=parameter.name,
                expression=parameter.name,
                kind=kind,
                joint=model.link_names[parameter.joint],
                unit=parameter_unit(model, columns[parameter.name]),
                value=value,
                std=std,
                rsd_percent=relative,
                f_value=(value / std) ** 2 if std else None,
                classical_std=std,
                significant=relative is not None and relative < identification.choices.significance,
                essential_value=value,
                essential_std=std,
                origin=ORIGIN,
            )
        )
    return entries


def _friction(friction: list[JointFrictionResult], held: HeldFriction) -> list[JointFrictionResult]:
    names = held.model.joint_names
    held_joints = {names[joint.motor]: joint for joint in held.joints}
    return [
        joint_friction.model_copy(update=_beta(held_joints[joint_friction.joint]))
        if joint_friction.joint in held_joints
        else joint_friction
        for joint_friction in friction
    ]


def _beta(joint: HeldJoint) -> dict[str, Any]:
    beta, std = temperature_estimate(joint.values, joint.covariance)
    return {"temperature": beta.tolist(), "temperature_std": std.tolist(), "temperature_origin": ORIGIN}


def _consistent(consistent: ConsistentModel, entries: list[BaseParameterResult]) -> ConsistentModel:
    """Held coefficients are none of a body's: they stay as they are."""
    held = [
        StandardParameterResult(
            name=entry.name, unit=entry.unit, value=entry.value or 0.0, std=entry.std, determined=1.0, known=False
        )
        for entry in entries
    ]
    values = {entry.name: entry.value or 0.0 for entry in entries}
    return consistent.model_copy(
        update={"parameters": [*consistent.parameters, *held], "base_values": {**consistent.base_values, **values}}
    )


def _estimate(estimate: EstimateResult, model: DynamicModel, held: HeldFriction) -> EstimateResult:
    """Estimate with the experiment's covariance as further blocks."""
    names, blocks = list(estimate.parameters), []
    for joint in held.joints:
        names += [parameter_of(model, joint.motor, kind).name for kind in joint.kinds]
        blocks.append(joint.covariance)
    count, size = len(estimate.parameters), len(names)
    root, covariance = np.zeros((size, size)), np.zeros((size, size))
    root[:count, :count] = estimate.root
    covariance[:count, :count] = [[np.inf if entry is None else entry for entry in row] for row in estimate.covariance]
    for block in blocks:
        place = slice(count, count + len(block))
        root[place, place] = np.linalg.cholesky(np.linalg.inv(block)).T
        covariance[place, place] = block
        count += len(block)
    return estimate.model_copy(update={"parameters": names, "root": root.tolist(), "covariance": covariance.tolist()})
