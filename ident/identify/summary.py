"""From what an identification found to the Result that is written to disk."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from typing import Literal

import numpy as np

from daq.recording import Recording, software_versions
from daq.robot import Robot
from drivers.streams import FloatArray
from ident.assessment.validation import FitFigures
from ident.identify.identification import Identification, PreparedRun
from ident.model.base_parameters import BaseParameters
from ident.model.dynamics import DynamicModel
from ident.model.parameters import Kind
from ident.regression.estimate import Estimate
from ident.regression.least_squares import LeastSquares
from ident.regression.observability import Experiment, describe, whole_arm
from ident.regression.pruning import Pruned, relative_std
from ident.result.schema import (
    UNITS,
    BaseParameterResult,
    DelayFigures,
    DriveGain,
    Essential,
    EstimateResult,
    Excitation,
    ExperimentResult,
    Fit,
    JointFriction,
    ModelOptions,
    ProcessingStep,
    RecordingUse,
    Residuals,
    Result,
    file_sha256,
)
from ident.signals.prepared import Step

GOOD_ERROR = 0.05
USABLE_ERROR = 0.10
POOR_ERROR = 0.20
"""Relative validation errors that the verdict's words stand for; published arms lie between 1.4 and 8.5 %."""


def summarise(found: Identification, recordings: Sequence[Recording], validation: Sequence[Recording]) -> Result:
    """The Result of an identification."""
    robot = found.robot_file.robot
    solution = found.solution
    factor = found.reduction.stacked()[:, list(solution.active)]
    lengths = np.linalg.norm(factor, axis=0)
    held_out = validation or recordings  # without validation recordings, their last parts
    used = [found.model.joint_names[motor] for motor in found.experiment.torques]
    return Result(
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        robot=robot.name,
        robot_file=found.robot_file.text,
        urdf=found.robot_file.urdf_text or "",
        joints=list(robot.joint_names),
        method=solution.method,
        options=_options(found),
        model_options=model_options(found.model),
        preprocessing=[
            ProcessingStep(name=step.name, settings=dict(step.settings), text=step.text)
            for step in (*found.runs[0].prepared.steps, _experiment_step(found))
        ],
        delay=DelayFigures(
            used=found.choices.preprocess.delay,
            best=found.delay.best if found.delay is not None else None,
            note=found.delay.note if found.delay is not None else "as given, not searched",
        ),
        base_parameters=_base_parameters(found),
        friction=friction_results(found.model, found.base, solution, found.std),
        drive_gains=gain_results(robot),
        fit=fit_result(found.fit),
        validation=fit_result(found.validation),
        validation_source=found.validation_source,
        essential=Essential(
            count=len(found.pruned.solution.active),
            dropped=[found.base.names[i] for i in found.pruned.dropped],
            stopped_by=found.pruned.stopped_by,
            fit=fit_result(found.essential_fit),
            validation=fit_result(found.essential_validation),
        ),
        excitation=Excitation(
            condition=solution.condition,
            scaled_condition=solution.scaled_condition,
            singular_values=np.linalg.svd(factor / lengths, compute_uv=False).tolist(),
            unexcited=[found.base.names[i] for i in range(found.base.count) if i not in solution.active],
        ),
        condition=solution.condition,
        residuals=Residuals(
            rows=solution.rows,
            effective_rows=found.corrected.effective_rows,
            joint_std=found.joint_std.tolist(),
            autocorrelation=found.corrected.autocorrelation.tolist(),
            block_length=found.corrected.block_length,
            blocks=found.corrected.blocks,
            repetitions=found.corrected.repetitions,
            correction=f"delete-block jackknife, {found.corrected.blocks} blocks of "
            f"{found.corrected.block_length} samples, repetitions of a motion in the same block",
        ),
        rank_margin=found.base.margin,
        recordings=[
            *(_use(*pair, "identification", used) for pair in zip(found.runs, recordings, strict=True)),
            *(_use(*pair, "validation", used) for pair in zip(found.validation_runs, held_out, strict=True)),
        ],
        versions=software_versions(),
        verdict=verdict(found),
        warnings=list(found.warnings),
        experiments=[experiment_result(found.model, found.experiment)],
        estimate=estimate_result(found.estimate, found.base.names),
    )


def model_options(model: DynamicModel) -> ModelOptions:
    """Which columns the model has."""
    return ModelOptions(
        motor_inertia=list(model.motor_inertia),
        viscous=list(model.viscous),
        coulomb=list(model.coulomb),
        offset=list(model.offset),
        smoothing=model.smoothing,
    )


def experiment_result(model: DynamicModel, experiment: Experiment) -> ExperimentResult:
    """An experiment by the names of the joints."""
    return ExperimentResult(
        locked={
            model.joint_names[joint]: [pose[place] for pose in experiment.poses]
            for place, joint in enumerate(experiment.locked)
        },
        torques_of=[model.joint_names[motor] for motor in experiment.torques],
    )


def estimate_result(estimate: Estimate, names: Sequence[str]) -> EstimateResult:
    """An estimate by the names of the base parameters."""
    others = [number for number in range(len(names)) if number not in estimate.active]
    return EstimateResult(
        parameters=[names[number] for number in estimate.active],
        root=estimate.root.tolist(),
        covariance=estimate.covariance.tolist(),
        taken_up={
            names[number]: shares.tolist()
            for number, shares in zip(others, estimate.taken_up.T, strict=True)
            if np.any(shares)
        },
        blocks=estimate.blocks,
    )


def _experiment_step(found: Identification) -> Step:
    """The experiment among the steps."""
    names = found.model.joint_names
    return Step(
        "experiment",
        {
            "locked": ", ".join(names[joint] for joint in found.experiment.locked),
            "torques_of": ", ".join(names[motor] for motor in found.experiment.torques),
        },
        describe(found.model, found.experiment),
    )


def judgement(error: float) -> str:
    """What a relative validation error is good for."""
    if error < GOOD_ERROR:
        return "good: fit for simulation, feed-forward and collision detection within the motions validated"
    if error < USABLE_ERROR:
        return "usable: fit for feed-forward; watch the joints with the largest errors"
    if error < POOR_ERROR:
        return "poor: look at the residuals for a missing term before using it"
    return "not to be trusted: the model misses much of what moves this arm"


def verdict(found: Identification) -> str:
    """How far to trust the model, in a few sentences."""
    error = found.validation.relative_error
    significant = int(np.sum(_significant(found)))
    text = (
        f"On {found.validation_source}, predicted torque differs from measured torque by {error * 100:.1f} % "
        f"(identification: {found.fit.relative_error * 100:.1f} %). That is {judgement(error)}. "
        f"{significant} of {found.base.count} base parameters are significant; "
        f"the essential model keeps {len(found.pruned.solution.active)} of them and is off by "
        f"{found.essential_validation.relative_error * 100:.1f} %."
    )
    if found.experiment != whole_arm(found.model):
        text += f" All of this holds for the experiment as it was: {describe(found.model, found.experiment)}."
    if found.warnings:
        count = len(found.warnings)
        text += f" {count} warning{'s' if count > 1 else ''} to read first."
    return text


def _significant(found: Identification) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    return np.asarray(relative_std(found.solution.parameters, found.std) < found.choices.significant_rsd)


def _options(found: Identification) -> dict[str, float | int | str | bool | None]:
    """What the run was asked for, cut-offs resolved, so that it can be repeated and a new recording treated alike."""
    chosen = found.choices
    preprocess = chosen.preprocess
    return {
        "position_cutoff": preprocess.position_cutoff,
        "torque_cutoff": preprocess.torque_cutoff,
        "decimate": preprocess.decimate,
        "position_decimate": preprocess.position_decimate,
        "filter_kind": preprocess.filter_kind,
        "delay": preprocess.delay,
        "measured_velocity": preprocess.measured_velocity,
        "start": preprocess.start,
        "stop": preprocess.stop,
        "rest_velocity": preprocess.rest_velocity,
        "keep_rest": preprocess.keep_rest,
        "split": chosen.split,
        "significant_rsd": chosen.significant_rsd,
        "energy_window": chosen.energy_window,
        "reversals": chosen.reversals,
    }


def _base_parameters(found: Identification) -> list[BaseParameterResult]:
    return parameter_results(
        found.model, found.base, found.solution, found.std, found.pruned, found.choices.significant_rsd
    )


def parameter_results(
    model: DynamicModel, base: BaseParameters, solution: LeastSquares, std: FloatArray, pruned: Pruned, threshold: float
) -> list[BaseParameterResult]:
    """The table of base parameters.

    Args:
        model: the arm.
        base: its base parameters (b).
        solution: of the full model.
        std: (b,) corrected standard deviations; inf where a parameter was not estimated.
        pruned: the essential model.
        threshold: of significance [%].
    """
    essential = pruned.solution
    rsd = relative_std(solution.parameters, std)
    inflation = np.divide(std, solution.std, out=np.ones(base.count), where=np.isfinite(solution.std))
    essential_std = essential.std * inflation
    symbols = [model.parameters[column].symbol for column in base.columns]

    def entry(i: int) -> BaseParameterResult:
        estimated, kept = i in solution.active, i in essential.active
        return BaseParameterResult(
            name=base.names[i],
            expression=base.expressions[i],
            kind=base.kinds[i],
            joint=model.link_names[base.joints[i]],
            unit=UNITS[symbols[i]],
            value=float(solution.parameters[i]) if estimated else None,
            std=float(std[i]),
            rsd_percent=float(rsd[i]),
            classical_std=float(solution.std[i]),
            significant=bool(rsd[i] < threshold),
            essential_value=float(essential.parameters[i]) if kept else None,
            essential_std=float(essential_std[i]) if kept else None,
        )

    return [entry(i) for i in range(base.count)]


def friction_results(
    model: DynamicModel, base: BaseParameters, solution: LeastSquares, std: FloatArray
) -> list[JointFriction]:
    """Friction of each joint with a motor; arguments as of `parameter_results`."""
    position = {(kind, joint): i for i, (kind, joint) in enumerate(zip(base.kinds, base.joints, strict=True))}

    def value(kind: Kind, joint: int, values: FloatArray) -> float | None:
        i = position.get((kind, joint))
        return float(values[i]) if i is not None and i in solution.active else None

    return [
        JointFriction(
            joint=name,
            viscous=value("viscous", joint, solution.parameters),
            viscous_std=value("viscous", joint, std),
            coulomb=value("coulomb", joint, solution.parameters),
            coulomb_std=value("coulomb", joint, std),
            offset=value("offset", joint, solution.parameters),
            offset_std=value("offset", joint, std),
        )
        for joint, name in zip(model.active, model.joint_names, strict=True)
    ]


def gain_results(robot: Robot) -> list[DriveGain]:
    """The drive gains of a robot file."""
    return [
        DriveGain(
            joint=name, signal=robot.drive(name).signal, gain=robot.drive(name).gain, std=robot.drive(name).gain_std
        )
        for name in robot.joint_names
    ]


def fit_result(figures: FitFigures) -> Fit:
    """Errors as they are stored."""
    return Fit(
        relative_error=figures.relative_error,
        joint_relative_error=figures.joint_relative_error.tolist(),
        rmse=figures.rmse.tolist(),
        low_speed_rmse=figures.low_speed_rmse.tolist(),
        high_speed_rmse=figures.high_speed_rmse.tolist(),
        max_error=figures.max_error.tolist(),
        samples=figures.samples,
    )


def values_sha256(recording: Recording) -> str:
    """SHA-256 of the values of a recording that has no file, as hexadecimal digits."""
    digest = sha256()
    for stream in recording.streams.values():
        for name, values in (("time", stream.time), *((name, c.values) for name, c in stream.channels.items())):
            digest.update(f"{stream.name}/{name}".encode())
            digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()


def _use(
    run: PreparedRun, recording: Recording, role: Literal["identification", "validation"], torques_of: list[str]
) -> RecordingUse:
    time = run.motion.time
    path = recording.path
    return RecordingUse(
        file=str(Path(run.motion.label).name) if path is not None else run.motion.label,
        sha256=file_sha256(path) if path is not None else values_sha256(recording),
        role=role,
        window=(
            run.choices.start or 0.0,
            float(time[-1] - time[0]) if run.choices.stop is None else run.choices.stop,
        ),
        samples=sum(segment.position.shape[1] for segment in run.prepared.segments),
        rate_hz=run.prepared.segments[0].rate,
        events=[f"{event.level}: {event.message}" for event in recording.events],
        torques_of=torques_of,
    )
