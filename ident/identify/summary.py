"""The Result of an identification, which is written to disk."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal

import numpy as np

from daq.recording.recording import Recording
from daq.recording.serial_numbers import serial_number
from daq.robot.schema import Robot
from drivers.core.arrays import FloatArray
from drivers.core.text import counted, percent_text
from drivers.core.units import ZERO_CELSIUS, common_unit
from ident.assessment.delay.delay import DelaySearch
from ident.assessment.validation import LOW_SPEED
from ident.identify.data_split import PreparedRun, RunWindow
from ident.identify.held_out import delivered_model, model_verdict
from ident.identify.held_result import with_held_friction
from ident.identify.identification import Identification
from ident.model.another_arm import robot_sha256
from ident.model.base_parameters import BaseParameters
from ident.model.dynamic_model import DynamicModel
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.regression.least_squares import LeastSquares
from ident.regression.observability import describe
from ident.regression.pruning import Pruned, partial_f, relative_std
from ident.regression.systematic_errors import gain_deviations, gain_sensitivity, relative_gain_std
from ident.result.consistent_model import consistent_model, link_results
from ident.result.estimate import EstimateResult, ExperimentResult
from ident.result.friction import friction_note, friction_results
from ident.result.result_file import file_sha256
from ident.result.schema import (
    BaseParameterResult,
    Convergence,
    DriveGainResult,
    Excitation,
    JointEquations,
    ModelOptions,
    RecordingUse,
    Residuals,
    Result,
)
from ident.result.units import parameter_unit
from ident.signals.joint_signals import joint_temperature
from ident.signals.prepared import Step
from ident.signals.sample_hashes import kept_hashes
from ident.verdict.verdict import Verdict

EPOCH_OF_2000 = 946684800.0
"""[s] since 1970. Stamps from here to now are absolute times; others count from a start of their own."""


class Identified(Identification):
    """An identification, and its result: the part of it that a file holds."""

    @cached_property
    def result(self) -> Result:
        """All that result.json holds."""
        return _result(self)


def _result(identification: Identification) -> Result:
    robot_file, robot = identification.robot_file, identification.robot_file.robot
    model, base, solution = identification.model, identification.base, identification.solution
    corrected, pruned = identification.corrected, identification.pruned
    factor = identification.reduction.stacked()[:, list(solution.active)]
    recordings = identification.recordings
    held_out = identification.held_out_recordings or recordings  # without validation recordings, their last parts
    used = [model.joint_names[motor] for motor in identification.experiment.torques]
    result = Result.of(
        robot_file,
        method=identification.choices.estimator.name,
        method_options=identification.choices.estimator.values,
        options=_options(identification),
        model_options=model_options(model),
        preprocessing=[
            _torque_step(identification),
            *identification.runs[0].prepared.steps,
            *identification.estimation.steps,
            _experiment_step(identification),
            *_friction_step(identification),
            *_presliding_step(identification),
        ],
        delay=identification.delay or DelaySearch(used=identification.choices.preprocess.delay),
        base_parameters=parameter_results(
            model,
            base,
            solution,
            identification.std,
            pruned,
            identification.choices.significance,
            _gain_std(identification),
            identification.repeatability,
        ),
        friction=friction_results(
            model,
            base,
            solution,
            identification.std,
            corrected.covariance,
            identification.shape_std,
            identification.repeatability,
        ),
        friction_note=friction_note(len(identification.runs), identification.repeatability),
        friction_steps=list(identification.friction.steps),
        standard_parameters=None
        if identification.consistent is None
        else link_results(model, identification.consistent.parameters),
        consistent=None
        if identification.consistent is None
        else consistent_model(
            model,
            base,
            robot_file,
            identification.consistent.parameters,
            identification.consistent.fit,
            identification.consistent.validation,
            [run.errors for run in identification.held_out],
        ),
        delivered=delivered_model(identification.consistent, identification.delivered_fit, identification.held_out),
        drive_gains=gain_results(
            robot,
            {
                name
                for run in identification.runs
                for joint, name in enumerate(run.signals.joint_names)
                if joint in run.torques and name in run.signals.gains_used
            },
        ),
        fit=identification.fit,
        validation=identification.validation,
        validation_source=identification.validation_source,
        essential=identification.essential,
        excitation=Excitation.of(base.names, solution, factor),
        residuals=Residuals(
            **_plain(corrected),
            rows=solution.rows,
            joint_std=identification.joint_std.tolist(),
            correction=f"delete-block jackknife, {corrected.blocks} blocks of {corrected.block_length} samples, "
            "repetitions of a motion in the same block",
            assumptions=identification.residual_tests,
        ),
        rank_margin=base.margin,
        recordings=[
            *(_use(*pair, "identification", used) for pair in zip(identification.runs, recordings, strict=True)),
            *(_use(*pair, "validation", used) for pair in zip(identification.validation_runs, held_out, strict=True)),
        ],
        verdict=Verdict("not judged yet"),
        experiments=[ExperimentResult.of(model, identification.experiment)],
        estimate=EstimateResult.of(identification.estimate, base.names, model.joint_names),
        convergence=convergence_result(identification),
        presliding=identification.presliding,
    )
    judged = with_held_friction(result, identification)
    of_runs = {check for run in identification.held_out for check in run.errors.checks}
    checks = [check for check in identification.checks if check not in of_runs]
    verdict = model_verdict(judged, checks, [run.errors for run in identification.held_out])
    return judged.model_copy(update={"verdict": verdict})


def model_options(model: DynamicModel) -> ModelOptions:
    """Return which columns the model has."""
    return ModelOptions.model_validate(model, from_attributes=True)


def _torque_step(identification: Identification) -> Step:
    """The step that says where the joint torques come from."""
    origin = identification.runs[0].signals.torque_origin
    return Step("joint torque", {"origin": origin}, origin)


def _experiment_step(identification: Identification) -> Step:
    """The experiment among the steps."""
    names, experiment = identification.model.joint_names, identification.experiment
    tolerance = identification.choices.experiment.rest_tolerance
    unit = common_unit("rad", identification.model.sliding)
    text = describe(identification.model, experiment)
    if experiment.locked:
        text += f" (locked: within the rest tolerance of {tolerance:g} {unit}, or within the encoder's noise)"
    return Step(
        "experiment",
        {
            "locked": ", ".join(names[joint] for joint in experiment.locked),
            "torques_of": ", ".join(names[motor] for motor in experiment.torques),
            "rest_tolerance": tolerance,
        },
        text,
    )


def _friction_step(identification: Identification) -> tuple[Step, ...]:
    """Return how the friction's shapes and load torque were found, among the steps; none where all were known."""
    friction = identification.friction
    of_position: tuple[Step, ...] = ()
    if friction.by_run is not None:
        before, after = friction.by_run
        kept = "in the model" if any(identification.model.needs("position")) else "left out: the gain is uncertain"
        text = "terms of the position, chosen by what predicts a run from the others, "
        text += (
            f"{kept} (error of the physically consistent model {before:.3g} σ without them, {after:.3g} σ with them)"
        )
        of_position = (Step("friction over the position", {"before": before, "after": after}, text),)
    if not friction.rounds:
        if friction.delivered is None:
            return of_position
        text = "further terms left out: the physically consistent model gains too little from them on held-out blocks "
        before, after = friction.delivered
        text += f"(error {before:.3g} σ without them, {after:.3g} σ with them)"
        return (Step("friction", {"rounds": 0}, text), *of_position)
    outcome = "settled after" if friction.settled else "had not settled after"
    text = f"shapes and load torque of the friction, estimated from the identification data, {outcome} "
    text += counted(friction.rounds, "round")
    return (Step("friction", {"rounds": friction.rounds, "settled": friction.settled}, text), *of_position)


def _presliding_step(identification: Identification) -> tuple[Step, ...]:
    """Pre-sliding travels among the steps; none where not asked for."""
    presliding = identification.presliding
    if presliding is None:
        return ()
    sliding = identification.model.sliding
    travels = ", ".join(
        f"{travel.parameter} {travel.travel:.2g} ± {WITHIN_95_PERCENT * travel.std:.1g}"
        for travel in presliding.travels
    )
    text = f"travel [{common_unit('rad', sliding)}] by Coulomb parameter: {travels or 'presliding lowers no error'}; "
    text += f"held-out error of joints slower than {LOW_SPEED:g} {common_unit('rad/s', sliding)} "
    text += f"{percent_text(presliding.error)} with it, "
    text += f"{percent_text(presliding.static_error)} without"
    return (Step("presliding", {entry.parameter: entry.travel for entry in presliding.travels}, text),)


def _options(identification: Identification) -> dict[str, float | int | str | bool | list[float] | None]:
    """What the run was asked for, cut-offs resolved, so that it can be repeated and a new recording treated alike."""
    choices = identification.choices
    return {
        **asdict(choices.preprocess),
        "split": choices.split,
        "essential": choices.essential,
        "significance": choices.significance,
        "reversals": choices.reversal_share,
        "rest_tolerance": choices.experiment.rest_tolerance,
    }


def _gain_std(identification: Identification) -> FloatArray | None:
    """Standard deviations (b,) of base parameters by the gains that were used; None where no row is a joint's own."""
    reduction, robot = identification.estimation.reduction, identification.robot_file.robot
    if len(reduction.joints) != identification.model.dof or identification.choices.estimator.equations != "torque":
        return None
    used = {name for run in identification.runs for name in run.signals.gains_used}
    moves = gain_sensitivity(reduction, identification.solution) * relative_gain_std(robot, used)
    return gain_deviations(moves.T)


def parameter_results(
    model: DynamicModel,
    base: BaseParameters,
    solution: LeastSquares,
    std: FloatArray,
    pruned: Pruned,
    threshold: float,
    gain_std: FloatArray | None = None,
    repeatability: FloatArray | None = None,
) -> list[BaseParameterResult]:
    """The table of base parameters.

    Args:
        model: the arm.
        base: its base parameters (b).
        solution: of the full model.
        std: (b,) corrected standard deviations; inf where a parameter was not estimated.
        pruned: the essential model.
        threshold: of significance [%].
        gain_std: (b,) standard deviations by the drive gains; None where they are unknown.
        repeatability: (b,) σ of friction between runs, nan of what has none; None where it is unknown.
    """
    essential = pruned.solution
    rsd, f_values = relative_std(solution.parameters, std), partial_f(solution.parameters, std)
    essential_std = np.hypot(std, essential.parameters - solution.parameters)  # the diagonal of `pruned_covariance`

    def entry(i: int) -> BaseParameterResult:
        estimated, kept = i in solution.active, i in essential.active
        return BaseParameterResult(
            name=base.names[i],
            expression=base.expressions[i],
            kind=base.kinds[i],
            joint=model.link_names[base.joints[i]],
            unit=parameter_unit(model, base.columns[i]),
            value=float(solution.parameters[i]) if estimated else None,
            std=float(std[i]),
            rsd_percent=float(rsd[i]),
            f_value=float(f_values[i]),
            gain_std=float(gain_std[i]) if gain_std is not None and estimated else None,
            repeatability=None if repeatability is None else float(repeatability[i]),
            classical_std=float(solution.std[i]),
            significant=bool(rsd[i] < threshold),
            essential_value=float(essential.parameters[i]) if kept else None,
            essential_std=float(essential_std[i]) if kept else None,
        )

    return [entry(i) for i in range(base.count)]


def gain_results(robot: Robot, used: Collection[str]) -> list[DriveGainResult]:
    """The drive gains of a robot file, of these joints."""
    drives = [robot.drive(name) for name in robot.joint_names if name in used]
    return [
        DriveGainResult(joint=drive.joint, signal=drive.signal, gain=drive.gain, std=drive.gain_std) for drive in drives
    ]


def _plain(values: object) -> dict[str, Any]:
    """Fields of a dataclass or of a model by name, arrays as lists."""
    return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in vars(values).items()}


def recording_sha256(recording: Recording) -> str:
    """SHA-256 of a recording's file, or of its values where they are not all of one, as hexadecimal digits."""
    if recording.path is not None and recording.part is None:
        return file_sha256(recording.path)
    digest = sha256()
    for stream in recording.streams.values():
        for name, values in (("time", stream.time), *((name, c.values) for name, c in stream.channels.items())):
            digest.update(f"{stream.name}/{name}".encode())
            digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()


def provenance(recording: Recording, joint_names: Sequence[str]) -> dict[str, Any]:
    """Fields of `UsedRecording` that say which arm was recorded, when and how warm."""
    kelvin = joint_temperature(recording, tuple(joint_names))
    first = recording.time[0] if len(recording.time) else 0.0
    absolute = EPOCH_OF_2000 <= first <= datetime.now(UTC).timestamp()
    return {
        "sha256": recording_sha256(recording),
        "robot_sha256": robot_sha256(recording),
        "started": datetime.fromtimestamp(first, UTC).isoformat(timespec="seconds") if absolute else recording.created,
        "serial": serial_number(recording),
        "temperature": [] if kelvin is None else [float(mean) for mean in kelvin.mean(axis=0) - ZERO_CELSIUS],
    }


def _use(
    run: PreparedRun, recording: Recording, role: Literal["identification", "validation"], torques_of: list[str]
) -> RecordingUse:
    time = run.signals.time
    path = recording.path
    return RecordingUse(
        file=str(Path(run.signals.label).name) if path is not None else run.signals.label,
        role=role,
        **provenance(recording, run.signals.joint_names),
        window=(run.choices.start or 0.0, float(time[-1] - time[0]) if run.choices.stop is None else run.choices.stop),
        samples=sum(segment.position.shape[1] for segment in run.prepared.segments),
        rate_hz=run.prepared.segments[0].rate,
        events=[f"{event.level}: {event.message}" for event in recording.events],
        torques_of=torques_of,
        sample_hashes=kept_hashes(RunWindow(run.signals, run.choices.start, run.choices.stop).hashes),
    )


def convergence_result(identification: Identification) -> Convergence | None:
    """Loops, passes and weights; None for a method that solves in one step."""
    estimation = identification.estimation
    if not estimation.loops:
        return None
    names = identification.model.joint_names
    equations = []
    if estimation.weights:
        weights = np.concatenate(estimation.weights, axis=1)
        for name, of_joint in zip(names, weights, strict=True):
            finite = of_joint[~np.isnan(of_joint)]
            equations.append(
                JointEquations(
                    joint=name,
                    equations=len(finite),
                    rejected=int(np.sum(finite == 0.0)),
                    mean_weight=float(finite.mean()) if len(finite) else None,
                )
            )
    covariance = estimation.joint_covariance
    deviations = np.sqrt(np.diag(covariance)) if covariance.size else np.empty(0)
    return Convergence(
        passes=estimation.passes,
        loops=list(estimation.loops),
        equations=equations,
        joint_correlation=(covariance / np.outer(deviations, deviations)).tolist() if covariance.size else [],
    )
