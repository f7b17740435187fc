"""The arm that a result's exports are made of."""

from __future__ import annotations

import numpy as np

from drivers.core.errors import ResultFileError, UsageError
from ident.export.arm import ExportedArm, refuse_unidentified_friction
from ident.friction.table import FRICTION_KINDS
from ident.model.base_parameters import base_parameters
from ident.model.inverse_dynamics import InverseDynamics
from ident.result.estimate import AGAIN
from ident.result.further_friction import without_further_friction
from ident.result.schema import Result
from ident.result.stored_model import StoredModel

FRICTION = (*(kind for kind in FRICTION_KINDS if kind != "offset"), "coupling")
"""Kinds of parameters that an export takes from the recording or not at all."""


def exported_arm(result: Result, kind: str, stored: StoredModel, dynamics: InverseDynamics) -> ExportedArm:
    """The arm of a result's consistent parameters.

    Args:
        result: that holds them.
        kind: parameters of the model that is to be exported.
        stored: the result's robot file and model.
        dynamics: of the model.

    Raises:
        UsageError: the model's parameters are no bodies.
        ResultFileError: parts of the result do not belong together.
        ModelError: some friction has neither a value nor an entry in the robot file's `known`.
    """
    consistent = result.consistent
    if kind != "consistent" or consistent is None:
        raise UsageError(
            f"the {kind} parameters are no bodies, which an export needs",
            where=result.robot,
            hint='load_model(…, parameters="consistent")',
        )
    values = {parameter.name: parameter.value for parameter in consistent.parameters}
    names = [parameter.name for parameter in stored.model.parameters]
    if set(names) != set(values):
        raise ResultFileError("the consistent parameters do not belong to the robot file beside them", hint=AGAIN)
    known = {parameter.name for parameter in consistent.parameters if parameter.known}
    unidentified = [
        f"{entry.name} of {entry.joint}"
        for entry in result.base_parameters
        if entry.value is None and entry.kind in FRICTION and entry.name not in known
    ]
    refuse_unidentified_friction(unidentified, result.robot)
    standard = np.array([values[name] for name in names])
    model, kept, lacking = without_further_friction(stored.model, standard)
    if lacking:
        base = base_parameters(model)
        dynamics = InverseDynamics(model, base, base.projection @ kept, kept)
    return ExportedArm(stored.robot_file, model, kept, dynamics, lacking)
