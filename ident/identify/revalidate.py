"""A stored model against another recording."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pydantic import TypeAdapter, ValidationError

from daq.recording.recording import Recording
from drivers.errors import ResultFileError
from drivers.percentage import percent_text
from drivers.streams import FloatArray
from ident.assessment.recording_checks import recording_checks
from ident.assessment.validation import FitFigures, fit_figures, overfitting_checks
from ident.identify.presliding import with_presliding
from ident.identify.summary import held_out_errors
from ident.model.presliding import dry_friction
from ident.model.regressor import RegressorKernel
from ident.regression.comparison import TorqueSeries, compare_torques, only_predicted
from ident.regression.observability import REST_TOLERANCE, predictable_torques
from ident.regression.velocity_reversals import leave_out_rest
from ident.result.schema import Fit, Result, presliding_of
from ident.result.stored_model import stored_model
from ident.signals.joint_signals import read_joint_signals
from ident.signals.options import PreprocessChoices
from ident.signals.pipeline import prepare
from ident.signals.played_motion import played_window
from ident.signals.prepared import Segment
from ident.verdict.verdict import Verdict, judge

CHECKS_OF_VALIDATION = ("overfitting", "errors-near-standstill", "not-validated")
"""Checks that depend on what was held out."""


@dataclass(frozen=True)
class Revalidation:
    """Torques of the full, the essential and the physically consistent model beside those of a recording.

    Attributes:
        series, essential_series: of the full and of the essential model.
        consistent_series: of the physically consistent one; None where the result holds none.
        segments: the recorded motion behind them, with all motors' torques.
    """

    series: tuple[TorqueSeries, ...]
    essential_series: tuple[TorqueSeries, ...]
    consistent_series: tuple[TorqueSeries, ...] | None
    segments: tuple[Segment, ...]

    @property
    def full(self) -> FitFigures:
        """Errors of the full model."""
        return fit_figures(self.series)

    @property
    def essential(self) -> FitFigures:
        """Errors of the essential model."""
        return fit_figures(self.essential_series)

    @property
    def consistent(self) -> FitFigures | None:
        """Errors of the physically consistent model."""
        return None if self.consistent_series is None else fit_figures(self.consistent_series)


def revalidate(result: Result, recording: Recording, *, presliding: bool = False) -> Revalidation:
    """Predict a recording's torques with a stored model, filters and delay as at its identification.

    Args:
        result: the model.
        recording: of the same arm.
        presliding: dry friction near velocity reversals by the result's pre-sliding travels.

    Raises:
        ResultFileError: the stored parameters do not belong to the stored robot file.
        DataError: the recording lacks what is needed.
        UsageError: the result holds no pre-sliding travels, where asked for.
    """
    travels = presliding_of(result).by_parameter if presliding else {}
    stored_parts = stored_model(result)
    model, base = stored_parts.model, stored_parts.base
    stored = {parameter.name: parameter for parameter in result.base_parameters}
    full = np.array([stored[name].value or 0.0 for name in base.names])
    essential = np.array([stored[name].essential_value or 0.0 for name in base.names])
    motion = read_joint_signals(recording, stored_parts.robot_file.robot)
    model.require_temperature(None if motion.temperature is None else motion.temperature.T, motion.label)
    start, stop = played_window(recording)
    choices = replace(stored_choices(result), start=start, stop=stop)
    prepared = leave_out_rest(RegressorKernel(model, base.columns), prepare(motion, choices))
    seconds = motion.time - motion.time[0]
    inside = (seconds >= (start or 0.0)) & (seconds <= (np.inf if stop is None else stop))
    tolerance = stored_rest_tolerance(result)
    torques = predictable_torques(model, stored_parts.experiments, motion.label, motion.position[inside], tolerance)

    def compared(values: FloatArray) -> tuple[TorqueSeries, ...]:
        series = compare_torques(model, base.columns, values, prepared.segments, prepared.parallel_filter)
        if travels:
            run = (prepared.segments, prepared.parallel_filter)
            series = with_presliding(dry_friction(model, base, values), travels, [run], series)
        return tuple(only_predicted(part, torques) for part in series)

    consistent = result.consistent
    return Revalidation(
        compared(full),
        compared(essential),
        None
        if consistent is None
        else compared(np.array([consistent.base_values.get(name, 0.0) for name in base.names])),
        tuple(prepared.segments),
    )


def validation_verdict(result: Result, recording: Recording, fit: Fit) -> Verdict:
    """The verdict on a stored model, its held-out errors replaced by those on another recording.

    Checks of the earlier validation do not count; those of the recording do.

    Args:
        result: the model.
        recording: it was validated with.
        fit: its errors there.
    """
    kept = [check for check in result.verdict.checks if check.name not in CHECKS_OF_VALIDATION]
    overfitting = [] if result.fit is None else overfitting_checks(result.fit, fit)
    checks = [*kept, *recording_checks(recording), *overfitting]
    error = "" if fit.relative_error is None else f" by {percent_text(fit.relative_error)}"
    basis = f"On {recording.label}, predicted torque differs from measured torque{error}."
    return judge(checks, held_out_errors(result.joints, fit), basis)


def stored_choices(result: Result) -> PreprocessChoices:
    """The preprocessing of the identification, its window left out: that belonged to its own recording."""
    names = PreprocessChoices.__dataclass_fields__
    chosen = {key: value for key, value in result.options.items() if key in names and key not in ("start", "stop")}
    try:
        return TypeAdapter(PreprocessChoices).validate_python(chosen)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(str(part) for part in first["loc"])
        raise ResultFileError(first["msg"], where=f"options.{key}", hint="identify again") from error


def stored_rest_tolerance(result: Result) -> float:
    """The rest tolerance of the identification [rad or m]; the default's where the result is older than the option."""
    stored = result.options.get("rest_tolerance")
    return float(stored) if isinstance(stored, (int, float)) and np.isfinite(stored) else REST_TOLERANCE
