"""A stored model against another recording."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pydantic import TypeAdapter, ValidationError

from daq.recording import Recording
from daq.robot import parse_robot
from drivers.errors import ResultFileError
from ident.base_parameters import base_parameters
from ident.comparison import TorqueSeries, compare_torques
from ident.measured import measured_motion
from ident.model import build_model
from ident.preprocess import PreprocessChoices, prepare
from ident.result import Result
from ident.validation import FitFigures, fit_figures


@dataclass(frozen=True)
class Revalidation:
    """Errors of the full and of the essential model on a recording, and the full model's torques."""

    full: FitFigures
    essential: FitFigures
    series: tuple[TorqueSeries, ...]


def revalidate(result: Result, recording: Recording) -> Revalidation:
    """Predict a recording's torques with a stored model, filters and delay as at its identification.

    Raises:
        ResultFileError: the stored parameters do not belong to the stored robot file.
        DataError: the recording lacks what is needed.
    """
    robot_file = parse_robot(
        result.robot_file, where="the result's robot file", folder=None, urdf_text=result.urdf or None
    )
    options = result.model_options
    for name in ("motor_inertia", "viscous", "coulomb", "offset"):
        if len(getattr(options, name)) != robot_file.robot.dof:
            raise ResultFileError(
                f"{len(getattr(options, name))} flags for {robot_file.robot.dof} joints",
                where=f"model_options.{name}",
                hint="identify again",
            )
    model = replace(
        build_model(robot_file),
        motor_inertia=tuple(options.motor_inertia),
        viscous=tuple(options.viscous),
        coulomb=tuple(options.coulomb),
        offset=tuple(options.offset),
        smoothing=options.smoothing,
    )
    base = base_parameters(model)
    stored = {parameter.name: parameter for parameter in result.base_parameters}
    if set(stored) != set(base.names):
        raise ResultFileError("the base parameters do not belong to the robot file beside them", hint="identify again")
    full = np.array([stored[name].value or 0.0 for name in base.names])
    essential = np.array([stored[name].essential_value or 0.0 for name in base.names])
    motion = measured_motion(recording, robot_file.robot)
    choices = _stored_choices(result)
    prepared = prepare(
        motion.time,
        motion.position,
        motion.torque,
        choices,
        velocity=motion.velocity,
    )
    series = compare_torques(model, base.columns, full, prepared.segments, prepared.parallel_filter)
    return Revalidation(
        full=fit_figures(series),
        essential=fit_figures(
            compare_torques(model, base.columns, essential, prepared.segments, prepared.parallel_filter)
        ),
        series=series,
    )


def _stored_choices(result: Result) -> PreprocessChoices:
    """The preprocessing of the identification, its window left out: that belonged to its own recording."""
    names = PreprocessChoices.__dataclass_fields__
    chosen = {key: value for key, value in result.options.items() if key in names and key not in ("start", "stop")}
    try:
        return TypeAdapter(PreprocessChoices).validate_python(chosen)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(str(part) for part in first["loc"])
        raise ResultFileError(first["msg"], where=f"options.{key}", hint="identify again") from error
