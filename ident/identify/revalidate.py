"""A stored model against another recording, and the figures that acceptance limits are compared with."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter, ValidationError

from daq.recording.reader import read_recording
from daq.recording.recording import Recording
from drivers.core.errors import ResultFileError
from ident.assessment.recording_checks import recording_checks
from ident.assessment.validation import Fit, fit_errors
from ident.estimators.feasible.armature import armature_vector
from ident.identify.data_split import PreparedRun, RunWindow, check_torques, copied, run_window
from ident.identify.held_out import HeldOutRun, ParameterSets, held_out_run
from ident.model.another_arm import check_arm
from ident.model.regressor import RegressorKernel
from ident.regression.comparison import TorqueSeries
from ident.regression.least_squares import LEAST_TORQUE
from ident.regression.observability import predictable_torques
from ident.regression.options import REST_TOLERANCE
from ident.regression.velocity_reversals import leave_out_rest
from ident.result.delivered import DELIVERED_WORDS, HeldOutErrors, delivered_parameters
from ident.result.graded import robots_of
from ident.result.result_file import file_sha256, stored_model
from ident.result.schema import RecordingUse, Result
from ident.signals.options import PreprocessChoices
from ident.signals.pipeline import prepare, prepare_with_rest
from ident.signals.sample_hashes import overlap
from ident.verdict.acceptance import ModelFigures
from ident.verdict.evidence import known
from ident.verdict.verdict import Verdict


@dataclass(frozen=True)
class Revalidation:
    """Torques of the full, the essential and the physically consistent model beside those of a recording."""

    # series, essential_series: of the full and of the essential model
    series: tuple[TorqueSeries, ...]
    essential_series: tuple[TorqueSeries, ...]
    # of the physically consistent one; None where the result holds none
    consistent_series: tuple[TorqueSeries, ...] | None
    delivered: HeldOutRun  # the model that is handed out by default, in motion and over all samples, and simulated

    @property
    def full(self) -> Fit:
        """Errors of the full model."""
        return fit_errors(self.series)

    @property
    def essential(self) -> Fit:
        """Errors of the essential model."""
        return fit_errors(self.essential_series)

    @property
    def consistent(self) -> Fit | None:
        """Errors of the physically consistent model."""
        return None if self.consistent_series is None else fit_errors(self.consistent_series)


def revalidate(result: Result, recording: Recording) -> Revalidation:
    """Predict a recording's torques with a stored model, filters and delay as at its identification.

    Raises:
        ResultFileError: the stored parameters do not belong to the stored robot file.
        DataError: the recording lacks what is needed.
    """
    stored_parts = stored_model(result)
    check_arm([recording], stored_parts.robot_file, robots_of(result.recordings))
    model, base = stored_parts.model, stored_parts.base
    stored = {parameter.name: parameter for parameter in result.base_parameters}
    full = np.array([stored[name].value or 0.0 for name in base.names])
    essential = np.array([stored[name].essential_value or 0.0 for name in base.names])
    found = result.consistent
    consistent = None if found is None else np.array([found.base_values.get(name, 0.0) for name in base.names])
    window = run_window(recording, stored_parts.robot_file.robot, PreprocessChoices())
    motion = window.signals
    if np.all(np.ptp(window.torque, axis=0) <= LEAST_TORQUE):
        check_torques([window], range(model.dof), model.joint_names)
    model.require_temperature(None if motion.temperature is None else motion.temperature.T, motion.label)
    choices = replace(stored_choices(result), start=window.start, stop=window.stop)
    kernel = RegressorKernel(model, base.columns)
    everything = prepared = prepare_with_rest(motion, choices, played=window.played)
    if not choices.keep_rest:
        prepared = leave_out_rest(kernel, prepare(motion, choices), motion.encoder_steps)
    tolerance = stored_rest_tolerance(result)
    torques = predictable_torques(model, stored_parts.experiments, motion.label, window.position, tolerance)
    armature = None if found is None else armature_vector(model, found.armature)
    parameters = ParameterSets(stored_parts.robot_file.robot, model, base, full, consistent, armature)
    data = PreparedRun(motion, choices, prepared, torques, everything, used_share(result, recording, window))
    checks = recording_checks(recording, label=recording.label)
    return Revalidation(
        parameters.series(full, prepared, torques),
        parameters.series(essential, prepared, torques),
        None if consistent is None else parameters.series(consistent, prepared, torques),
        held_out_run(parameters, data, result.delivered.fit, motion.label, checks),
    )


def used_share(result: Result, recording: Recording, window: RunWindow) -> float:
    """The share of a recording's samples that a model was identified from."""
    used = [use for use in result.recordings if use.role == "identification"]
    if recording.path is not None and not any(use.sample_hashes for use in used):  # of an earlier version
        return float(any(use.sha256 == file_sha256(recording.path) for use in used))
    share = overlap(window.hashes, [use.sample_hashes for use in used])
    return (
        1.0 if share == 0.0 and any(copied(window, [own]) for own in _still_there(result, recording, used)) else share
    )


def _still_there(result: Result, recording: Recording, used: Sequence[RecordingUse]) -> Iterator[RunWindow]:
    """The recordings of the identification that lie beside this one or in the working folder, unchanged."""
    for use, path in unchanged_files(used, [] if recording.path is None else [recording.path.parent]):
        chosen = PreprocessChoices(start=use.window[0], stop=use.window[1])
        yield run_window(read_recording(path), stored_model(result).robot_file.robot, chosen)


def unchanged_files(used: Sequence[RecordingUse], folders: Sequence[Path]) -> Iterator[tuple[RecordingUse, Path]]:
    """The files of recordings that are what they were: where they were, in the working folder, or in `folders`."""
    for use in used:
        for path in (Path(use.file), *(folder / Path(use.file).name for folder in (Path(), *folders))):
            if path.suffix == ".h5" and path.is_file() and file_sha256(path) == use.sha256:
                yield use, path
                break


def stored_choices(result: Result) -> PreprocessChoices:
    """The preprocessing of the identification, its window left out: that belonged to its own recording."""
    names = PreprocessChoices.__dataclass_fields__
    chosen = {key: value for key, value in result.options.items() if key in names and key not in ("start", "stop")}
    try:
        return TypeAdapter(PreprocessChoices).validate_python(chosen)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(str(step) for step in first["loc"])
        raise ResultFileError(first["msg"], where=f"options.{key}", hint="identify again") from error


def stored_rest_tolerance(result: Result) -> float:
    """The rest tolerance of the identification [rad or m]; the default's where the result is older than the option."""
    stored = result.options.get("rest_tolerance")
    return float(stored) if isinstance(stored, (int, float)) and np.isfinite(stored) else REST_TOLERANCE


def result_figures(result: Result) -> ModelFigures:
    """Figures of an identification or a merge on its held-out data."""
    delivered = result.delivered
    return acceptance_figures(result, delivered.validation_all_samples, delivered.runs, result.verdict)


def acceptance_figures(
    result: Result, errors: Fit | None, runs: Sequence[HeldOutErrors], verdict: Verdict
) -> ModelFigures:
    """Figures of the delivered model on held-out recordings; none on data that it was identified from.

    Args:
        result: the model.
        errors: over all samples of the recordings together.
        runs: each apart.
        verdict: on the model with these data.
    """
    held_out = errors if runs and all(run.held_out for run in runs) else None
    joints = result.joints
    return ModelFigures(
        model=DELIVERED_WORDS[delivered_parameters(result.consistent)],
        relative_error=None if held_out is None else held_out.relative_error,
        joint_relative_error=_by_joint(joints, None if held_out is None else held_out.joint_relative_error),
        rmse=_by_joint(joints, None if held_out is None else held_out.rmse),
        motion_rmse=_by_joint(joints, _motion_error(runs)),
        sliding=dict(zip(joints, result.sliding, strict=True)),
        consistent=result.consistent is not None,
        consistency_cost=_cost(runs),
        verdict=verdict,
    )


def _motion_error(runs: Sequence[HeldOutErrors]) -> Sequence[float | None] | None:
    """The largest error of each joint over the recordings; none where one could not be simulated."""
    motions = [None if run.simulation is None else run.simulation.position_rmse for run in runs]
    if not motions or any(motion is None for motion in motions):
        return None
    return [max(of_joint) for of_joint in zip(*(motion for motion in motions if motion is not None), strict=True)]


def _cost(runs: Sequence[HeldOutErrors]) -> float | None:
    """The largest ratio of the delivered model's error to the full one's over the recordings."""
    ratios = [_ratio(run.all_samples, run.full_all_samples) for run in runs if run.full_all_samples is not None]
    return max((ratio for ratio in ratios if ratio is not None), default=None)


def _by_joint(joints: Sequence[str], values: Sequence[float | None] | None) -> Mapping[str, float | None]:
    return dict.fromkeys(joints) if values is None else dict(zip(joints, values, strict=True))


def _ratio(consistent: Fit | None, full: Fit | None) -> float | None:
    if consistent is None or full is None or not full.relative_error:
        return None
    return known(consistent.relative_error / full.relative_error)
