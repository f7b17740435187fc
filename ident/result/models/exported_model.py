"""What an identified model writes for others: URDF, MJCF, inertial YAML, C code, a Pinocchio model.

Friction that URDF, MJCF and Pinocchio models cannot hold is left out of them, and described.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property
from os import PathLike
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import ModelError, ResultFileError, UsageError
from drivers.core.software import software_versions
from drivers.core.text import percent_text
from ident.assessment.validation import Fit
from ident.export.arm import ExportedArm, refuse_unidentified_friction
from ident.friction.table import FRICTION_KINDS, POSITION_KINDS, REFERENCE_TEMPERATURE, SHAPED, SHAPES, TERMS
from ident.friction.terms import NO_TERMS, FrictionConditions
from ident.model.base_parameters import base_parameters, random_states
from ident.model.dynamic_model import DynamicModel
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.model.joint_columns import column_signal, joint_column
from ident.model.parameters import StandardParameter
from ident.model.regressor import LoadTorqueKernel
from ident.result.delivered import Parameters
from ident.result.estimate import AGAIN
from ident.result.models.model_parameters import ModelParameters
from ident.result.result_file import StoredModel
from ident.result.schema import Result

if TYPE_CHECKING:
    from ident.export.export import Export

FRICTION = (*(kind for kind in FRICTION_KINDS if kind != "offset"), "coupling")
"""Kinds of parameters that an export takes from the recording or not at all."""
KINDS: dict[Parameters, str] = {
    "consistent": "the base parameters of bodies that can exist",
    "full": "all base parameters as estimated",
    "essential": "the significant base parameters, the others 0",
}
"""What the models hold, for comments in what they write."""
SPEEDS = 50
"""Speeds up to a joint's limit at which the nearest Coulomb and viscous friction is found."""
POSES = 200
"""Random poses whose mean load counts."""


def origin_lines(result: Result, kind: Parameters) -> tuple[str, ...]:
    """Versions, date of the identification, recordings with their SHA-256, held-out error, verdict.

    The date is that of the identification, and nothing tells when the export was written: the same model gives the
    same files.
    """
    identified, own = result.versions.get("dynid", "unknown"), software_versions()["dynid"]
    writer = "" if own == identified else f", written by dynid {own}"
    recordings = [f"  {use.role}: {use.file}, {use.samples} samples, SHA-256 {use.sha256}" for use in result.recordings]
    return (
        f"Identified {result.created} by dynid {identified}, method {result.method}{writer}.",
        *(["Recordings:", *recordings] if recordings else []),
        _error(held_out(result, kind)),
        f"Verdict: {result.verdict.headline}",
    )


def held_out(result: Result, kind: Parameters) -> Fit | None:
    """The error on held-out data of these parameters."""
    if kind == "consistent":
        return None if result.consistent is None else result.consistent.validation
    return result.validation if kind == "full" else result.essential.validation


def _error(fit: Fit | None) -> str:
    if fit is None or not math.isfinite(fit.relative_error):
        return "Held-out error: not known, no recording was held out."
    joints = ", ".join(percent_text(error) for error in fit.joint_relative_error)
    return f"Held-out error of the torque: {percent_text(fit.relative_error)}; joint by joint {joints}."


def exported_arm(result: Result, kind: str, stored: StoredModel, dynamics: InverseDynamics) -> ExportedArm:
    """The arm of a result's consistent parameters.

    Raises:
        UsageError: the model's parameters are not those of bodies.
        ResultFileError: parts of the result do not belong together.
        ModelError: some friction has neither a value nor an entry in the robot file's `known`.
    """
    consistent = result.consistent
    if kind != "consistent" or consistent is None:
        raise UsageError(
            f"the {kind} parameters are not those of bodies, which an export needs",
            where=result.robot,
            hint='load_model(…, parameters="consistent")',
        )
    values = {parameter.name: parameter.value for parameter in consistent.parameters}
    names = [parameter.name for parameter in stored.model.parameters]
    if set(names) != set(values):
        raise ResultFileError("the consistent parameters do not belong to the robot file stored with them", hint=AGAIN)
    stated = {parameter.name for parameter in consistent.parameters if parameter.known}
    unidentified = [
        f"{entry.name} of {entry.joint}"
        for entry in result.base_parameters
        if entry.value is None and entry.kind in FRICTION and entry.name not in stated
    ]
    refuse_unidentified_friction(unidentified, result.robot)
    standard = np.array([values[name] for name in names])
    model, kept, lacking = without_further_friction(stored.model, standard)
    if lacking:
        base = base_parameters(model)
        dynamics = InverseDynamics(model, base, base.projection @ kept, kept)
    return ExportedArm(stored.robot_file, model, kept, dynamics, lacking)


class ExportedModel(ModelParameters):
    """Parameters that can be written as the files of simulators and controllers."""

    def to_pinocchio(self) -> Any:
        """A `pinocchio.Model` of the arm: bodies, armature, damping, dry friction, limits, gravity.

        `pin.rnea` gives the links' and the motor inertias' torques; friction is left to the user of Pinocchio. Closed
        loops are open in it, with free joints; coupled motors and offsets are not in it.

        Raises:
            UsageError: these are not the consistent parameters.
            ModelError: some friction was not identified.
        """
        from ident.export.arm import pinocchio_arm

        return pinocchio_arm(self._exported)

    def export_urdf(
        self, path: str | PathLike[str], *, into: str | PathLike[str] | None = None, overwrite: bool = False
    ) -> Export:
        """Write a URDF: the robot's own with new inertials, friction and limits, or a complete one from MDH.

        It is read again by Pinocchio (and MuJoCo, if installed), compared with `torque`, and simulated for 5 s.

        Args:
            path: of the file.
            into: another URDF of the same arm, with meshes for instance, to put the model in.
            overwrite: replace what exists.

        Raises:
            UsageError: the file exists or cannot be written, or these are not the consistent parameters.
            RobotFileError: `into` is not a URDF of this arm.
            ModelError: some friction was not identified, or the file reads back as another model.
        """
        from ident.export.export import export_urdf

        return export_urdf(self._exported, path, into=into, overwrite=overwrite)

    def export_mjcf(self, path: str | PathLike[str], *, overwrite: bool = False) -> Export:
        """Write an MJCF with motor inertia (`armature` included), friction, offsets, coupled motors and closed loops.

        Where MuJoCo is installed it is read again, compared with `torque`, and simulated for 5 s.

        Args:
            path: of the file.
            overwrite: replace what exists.

        Raises:
            UsageError: the file exists or cannot be written, or these are not the consistent parameters.
            ModelError: some friction was not identified, or the file reads back as another model.
        """
        from ident.export.arm import with_armature
        from ident.export.export import export_mjcf

        return export_mjcf(with_armature(self._exported, self.armature), path, overwrite=overwrite)

    def export_ros2_inertial(self, path: str | PathLike[str], *, overwrite: bool = False) -> Export:
        """Write the links' bodies as YAML in the form of Universal_Robots_ROS2_Description's `inertia_parameters`.

        Args:
            path: of the file.
            overwrite: replace what exists.

        Raises:
            UsageError: the file exists or cannot be written, or these are not the consistent parameters.
            ModelError: some friction was not identified.
        """
        from ident.export.export import export_ros2_inertial

        return export_ros2_inertial(self._exported, path, overwrite=overwrite)

    def export_c(
        self, path: str | PathLike[str], *, real: Literal["double", "float"] = "double", overwrite: bool = False
    ) -> Export:
        """Write C99 source of this model: torque and its parts, inertia matrix, forward dynamics, payload, regressor.

        Straight-line code for this arm and these parameters, without allocation, with a self-test. The header says
        where the parameters come from: versions, recordings with their hashes, held-out error.

        Args:
            path: of both files, without suffix: `arm` gives arm.h and arm.c.
            real: type of the arithmetic.
            overwrite: replace what exists.

        Raises:
            UsageError: a file exists, cannot be written, or has a name that C cannot include.
            ModelError: a parameter was not identified, or loops of the arm are solved numerically.
        """
        from ident.export.c_code.source import Parameter
        from ident.export.c_code.write import write_c

        if self._missing:
            raise ModelError(
                f"{', '.join(self._base.names[index] for index in self._missing)} has no value: the recording did not "
                "excite it",
                where=self.name,
                hint='record a motion that does, or load_model(…, parameters="essential"), which assumes 0',
            )
        if self.kind == "consistent":
            _ = self._exported  # refuses friction that no recording determined
        deviations = self._known_std()
        parameters = [
            Parameter(entry.name, float(value), deviations[entry.name], entry.unit, entry.expression)
            for entry, value in zip(self._entries, self._values, strict=True)
        ]
        return write_c(
            self._dynamics,
            path,
            real=real,
            kind=KINDS[self.kind],
            origin=origin_lines(self.result, self.kind),
            parameters=parameters,
            overwrite=overwrite,
        )

    @cached_property
    def _exported(self) -> ExportedArm:

        return exported_arm(self.result, self.kind, self._stored, self._dynamics)


def without_further_friction(
    model: DynamicModel, values: FloatArray
) -> tuple[DynamicModel, FloatArray, tuple[str, ...]]:
    """The model with Coulomb, linear viscous friction and offsets only, its standard parameters, and what it lacks.

    Coulomb and viscous friction of a joint with further terms are those nearest to its curve, by least squares over
    speeds up to its limit, at 25 °C, under the mean load of random poses and in the mean over a turn.

    Args:
        model: as identified.
        values: (p,) its standard parameters.
    """
    travels = [name for name, _ in model.presliding]
    gradual: tuple[str, ...] = (
        (f"presliding of {', '.join(travels)}: friction changes sign at once",) if travels else ()
    )
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
        if joints and term.needs == "position":
            gradual += (f"{term.left_out} of {', '.join(joints)}: it has its mean over a turn",)
        elif joints:
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
        sentences.append("they are replaced by the nearest Coulomb and viscous friction up to the joints' limits")
    return simple, kept, (*sentences, *gradual)


def _nearest(model: DynamicModel, value_of: dict[str, float]) -> dict[str, float]:
    """Coulomb and viscous parameters, by name, of the motors whose friction has further terms."""
    load = None
    if model.needs_load_torque:
        loads = LoadTorqueKernel(model).torque(random_states(model, POSES)[0])
        load = np.mean(np.abs(loads), axis=1)
    values: dict[str, float] = {}
    for motor, joint in enumerate(model.active):
        own = [
            parameter
            for parameter in model.parameters
            if parameter.joint == joint
            and parameter.kind not in ("inertial", "motor_inertia", "offset", "coupling", *POSITION_KINDS)
        ]
        plain = {parameter.kind: parameter.name for parameter in own if parameter.kind in ("coulomb", "viscous")}
        bent = any(model.terms.shape_of(kind, motor) != 1.0 for kind in plain)
        if not plain or (len(own) == len(plain) and not bent):
            continue
        speed = np.linspace(0.0, model.limits[motor].velocity, SPEEDS + 1)[1:]
        curve = np.sum([value_of[column.name] * _signal(model, column, speed, load) for column in own], axis=0)
        columns = np.column_stack([np.ones_like(speed) if kind == "coulomb" else speed for kind in plain])
        values |= dict(zip(plain.values(), _not_negative(columns, curve), strict=True))
    return values


def _signal(
    model: DynamicModel, parameter: StandardParameter, speed: FloatArray, load: FloatArray | None
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
