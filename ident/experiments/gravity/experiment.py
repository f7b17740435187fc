"""Identification of gravity: recordings in, result out; and the same model on other recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from daq.recording.recording import Recording
from daq.robot.loader import RobotFile, parse_robot
from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError, UsageError
from drivers.core.reading_process import Progress
from drivers.core.text import percent_text
from ident.assessment.recording_checks import recording_checks
from ident.experiments.gravity.fit import GravityFit, fit_gravity, used_equations
from ident.experiments.gravity.passes import Visit, Visits, find_visits
from ident.experiments.gravity.suspicions import doubts, file_parameters, refuse_wrong_size
from ident.identify.summary import provenance, recording_sha256
from ident.model.another_arm import check_arm
from ident.model.base_parameters import BaseParameters, gravity_base, gravity_columns, gravity_rows, resting_model
from ident.model.dynamic_model import DynamicModel
from ident.model.parameters import LINK_SIZE
from ident.result.graded import Grade, robots_of
from ident.result.gravity import (
    GravityJoint,
    GravityParameter,
    GravityPose,
    GravityRecording,
    GravityResult,
    GravityValidation,
)
from ident.result.units import parameter_unit
from ident.signals.joint_signals import JointSignals, read_joint_signals

GOOD, USABLE = 0.03, 0.1
"""Held-out errors over a joint's gravity torque below which it is good and usable …"""

GOOD_FRICTION, USABLE_FRICTION = 0.5, 1.0
"""… or over its friction: what is smaller does not move a joint that is released."""

FEW_POSES = 8
"""Number of poses below which held-out errors say little."""

_SILENT = 1e-9


@dataclass(frozen=True, eq=False)
class GravityExperiment:
    """What an identification gives."""

    result: GravityResult  # as result.json holds it
    # of the recordings, for the page; empty where the result was read from a file
    signals: tuple[JointSignals, ...] = ()


def analyse_gravity(
    recordings: Sequence[Recording],
    held_out: Sequence[Recording],
    robot_file: RobotFile | None,
    commanded: Sequence[str],
    progress: Progress,
) -> GravityExperiment:
    """Identify the gravity of an arm from poses passed slowly in both directions.

    Raises:
        DataError: no pose is passed in both directions, or the torques are not those of such an arm.
        IdentificationError: too few poses.
    """
    if not recordings:
        raise UsageError("no recording to identify from")
    file = robot_file or recordings[0].robot()
    if robot_file is None:
        check_arm((*recordings[1:], *held_out), file)
    progress("poses")
    model = resting_model(file)
    base = gravity_base(model)
    if not np.any(base.projection[:, : LINK_SIZE * len(model.joints)]):
        raise DataError(
            "gravity acts on no joint of this arm", where=file.robot.name, hint="there is nothing to identify"
        )
    signals = tuple(read_joint_signals(recording, file.robot) for recording in recordings)
    by_run = [find_visits(signal, model, base) for signal in signals]
    visits = [visit for of_run in by_run for visit in of_run.visits]
    refuse_wrong_size(visits, model, recordings[0].label)
    progress("gravity")
    fit = fit_gravity(visits, model)
    together = Visits(
        visits,
        [pose for run_visits in by_run for pose in run_visits.unbalanced],
        np.max([run_visits.moved for run_visits in by_run], axis=0),
    )
    stuck = [name for name, moved in zip(model.joint_names, together.moved, strict=True) if not moved]
    concerns = doubts(file, model, base, together, fit, [name for name in stuck if name in commanded])
    for recording in recordings:
        concerns += [(False, check.text) for check in recording_checks(recording) if check.severity != "note"]
    of_joints = _of_joints(file, model, base, visits, fit)
    poses = [
        GravityPose(
            position=visit.pose.tolist(),
            time=visit.time,
            recording=visit.recording,
            measured=_numbers(np.where(used, visit.mean[0], np.nan)),
            predicted=_numbers(np.where(used, visit.mean[0] - error, np.nan)),
        )
        for visit, used, error in zip(visits, fit.used, fit.held_out, strict=True)
    ]
    inertial = gravity_columns(base)
    weighing = gravity_rows(model, base, np.array([visit.pose for visit in visits]))[:, :, inertial]
    result = GravityResult.of(
        file,
        sliding=list(model.sliding),
        torque_origin=signals[0].torque_origin,
        gravity_parameters=_parameters(model, base, fit),
        covariance=fit.covariance.tolist(),
        of_joints=of_joints,
        poses=poses,
        silent=[
            name
            for joint, name in enumerate(model.joint_names)
            if not np.any(np.abs(weighing[:, joint]) > _SILENT) and not _slides_along(base, model, joint)
        ],
        recordings=[
            *(
                _use(recording, "identification", len(passes.visits))
                for recording, passes in zip(recordings, by_run, strict=True)
            ),
            *(_use(recording, "validation", 0) for recording in held_out),
        ],
        verdict=gravity_verdict(
            of_joints, _errors(of_joints), len(set(fit.group.tolist())), concerns, "left out one by one"
        ),
    )
    experiment = GravityExperiment(result, signals)
    return revalidated(experiment, held_out) if held_out else experiment


def revalidated(experiment: GravityExperiment, recordings: Sequence[Recording]) -> GravityExperiment:
    """The same model with its errors on other recordings of poses passed in both directions.

    Raises:
        DataError: a recording is of another arm, or passes no pose in both directions.
    """
    result = experiment.result
    file = parse_robot(result.robot_file, where="the result's robot file", folder=None, urdf_text=result.urdf or None)
    model = resting_model(file)
    base = gravity_base(model)
    values = np.array([parameter.value or 0.0 for parameter in result.gravity_parameters])
    errors = []
    for recording in recordings:
        check_arm([recording], file, robots_of(result.recordings))
        visits = find_visits(read_joint_signals(recording, file.robot), model, base).visits
        used = used_equations(visits, model)
        torque, rows = (np.array([visit.mean[direction] for visit in visits]) for direction in (0, 1))
        errors.append(np.where(used, torque - rows @ values, np.nan))
    error = np.concatenate(errors)
    with np.errstate(all="ignore"):
        rms = np.sqrt(np.array([np.nanmean(column**2) if np.isfinite(column).any() else np.nan for column in error.T]))
        largest = np.array([np.nanmax(np.abs(column)) if np.isfinite(column).any() else np.nan for column in error.T])
    own = {use.sha256 for use in result.recordings if use.role == "identification"}
    held_out = not any(recording_sha256(recording) in own for recording in recordings)
    validation = GravityValidation(rms=_numbers(rms), max=_numbers(largest), poses=len(error), held_out=held_out)
    concerns = [(False, text) for text in result.verdict.checks]
    if not held_out:
        concerns.append((False, "not held out: these data are in the identification"))
    whose = "of other recordings" if held_out else "of its own recordings"
    verdict = gravity_verdict(result.of_joints, (rms, largest), len(error), concerns, whose)
    worse = result.verdict.grade == "poor" or (result.verdict.grade == "usable" and verdict.grade == "good")
    if worse:
        verdict = verdict.model_copy(
            update={
                "grade": result.verdict.grade,
                "headline": verdict.headline.replace(verdict.grade.capitalize(), result.verdict.grade.capitalize(), 1),
            }
        )
    return GravityExperiment(
        result.model_copy(update={"validation": validation, "verdict": verdict}), experiment.signals
    )


def gravity_verdict(
    joints: Sequence[GravityJoint],
    errors: tuple[FloatArray, FloatArray],
    poses: int,
    concerns: Sequence[tuple[bool, str]],
    basis: str,
) -> Grade:
    """A grade for gravity compensation by errors (n,), root mean square and largest, in held-out poses."""
    levels: list[tuple[int, float, str]] = []
    for joint, rms, largest in zip(joints, *errors, strict=True):
        if not np.isfinite(rms):
            continue
        weight = rms / joint.gravity if joint.gravity > 0 else np.inf
        sticking = largest / joint.friction if joint.friction and joint.friction > 0 else np.inf
        level = (
            0
            if weight < GOOD or sticking < GOOD_FRICTION
            else 1
            if weight < USABLE or sticking < USABLE_FRICTION
            else 2
        )
        text = f"{joint.joint} misses by {rms:.2g} {joint.unit} (up to {largest:.2g}"
        text += f", friction {joint.friction:.2g})" if joint.friction else ")"
        levels.append((level, min(weight, sticking), text))
    worst = max(levels, default=(2, 0.0, "no joint has an error to judge"))
    level = worst[0]
    if any(serious for serious, _ in concerns):
        level = 2
    elif level == 0 and (
        poses < FEW_POSES or any("not held out" in text or "not determined" in text for _, text in concerns)
    ):
        level = 1
    grade: Literal["good", "usable", "poor"] = ("good", "usable", "poor")[level]
    finite = [
        float(rms / joint.gravity)
        for joint, rms in zip(joints, errors[0], strict=True)
        if joint.gravity > 0 and np.isfinite(rms)
    ]
    mean = f"errors of {percent_text(float(np.median(finite)), 2)} of gravity, median of the joints; " if finite else ""
    serious = [text for bad, text in concerns if bad]
    because = serious[0] if serious else f"{mean}{worst[2]}"
    headline = f"{grade.capitalize()} for gravity compensation, by {poses} poses {basis}: {because}."
    return Grade(grade=grade, headline=headline, checks=list(dict.fromkeys(text for _, text in concerns)))


def _parameters(model: DynamicModel, base: BaseParameters, fit: GravityFit) -> list[GravityParameter]:
    deviation = np.sqrt(np.diag(fit.covariance))
    entries = []
    for index, column in enumerate(base.columns):
        parameter = model.parameters[column]
        determined, value = bool(fit.determined[index]), float(fit.values[index])
        half = float(fit.quantile[index] * deviation[index])
        offset = parameter.kind == "offset"
        weighs = offset and _weighs(base, model, index)
        note = "" if determined else "not determined by these poses"
        if determined and offset:
            note = "offset and weight, which act alike" if weighs else "offset of the motor's torque"
        entries.append(
            GravityParameter(
                name=base.names[index],
                expression=base.expressions[index],
                kind="offset" if offset else "inertial",
                joint=model.link_names[parameter.joint],
                unit=parameter_unit(model, column),
                value=value if determined else None,
                std=float(deviation[index]) if determined else None,
                low=value - half if determined else None,
                high=value + half if determined else None,
                note=note,
            )
        )
    return entries


def _of_joints(
    file: RobotFile, model: DynamicModel, base: BaseParameters, visits: Sequence[Visit], fit: GravityFit
) -> list[GravityJoint]:
    torque, rows = (np.array([visit.mean[direction] for visit in visits]) for direction in (0, 1))
    weighing = [index for index in range(base.count) if base.kinds[index] == "inertial" or _weighs(base, model, index)]
    gravity = rows[:, :, weighing] @ fit.values[weighing]
    file_values = file_parameters(file, model, base)
    joints = []
    for joint, limits in enumerate(model.limits):
        used, error = fit.used[:, joint], fit.held_out[:, joint]
        error = error[np.isfinite(error)]
        of_file = None
        if file_values is not None and np.any(used):
            inertial = [index for index, kind in enumerate(base.kinds) if kind == "inertial"]
            rest = (torque[:, joint] - rows[:, joint][:, inertial] @ file_values[inertial])[used]
            of_file = float(np.std(rest))
        joints.append(
            GravityJoint(
                joint=limits.name,
                unit=limits.unit("N·m"),
                poses=int(used.sum()),
                gravity=size if (size := float(np.sqrt(np.mean(gravity[:, joint] ** 2)))) > _SILENT else 0.0,
                friction=float(fit.friction[joint]),
                friction_interval=float(fit.friction_interval[joint]),
                friction_spread=float(fit.friction_spread[joint]),
                held_out_rms=float(np.sqrt(np.mean(error**2))) if len(error) else None,
                held_out_max=float(np.max(np.abs(error))) if len(error) else None,
                model_file_rms=of_file,
            )
        )
    return joints


def _errors(joints: Sequence[GravityJoint]) -> tuple[FloatArray, FloatArray]:
    return (
        np.array([np.nan if joint.held_out_rms is None else joint.held_out_rms for joint in joints]),
        np.array([np.nan if joint.held_out_max is None else joint.held_out_max for joint in joints]),
    )


def _weighs(base: BaseParameters, model: DynamicModel, index: int) -> bool:
    """Return whether a parameter has a part of some link's inertia in it."""
    return bool(np.any(base.projection[index, : LINK_SIZE * len(model.joints)]))


def _slides_along(base: BaseParameters, model: DynamicModel, joint: int) -> bool:
    """Return whether a joint's offset holds a weight."""
    return any(
        model.active[joint] == of and kind == "offset" and _weighs(base, model, index)
        for index, (of, kind) in enumerate(zip(base.joints, base.kinds, strict=True))
    )


def _numbers(values: FloatArray) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]


def _use(recording: Recording, role: Literal["identification", "validation"], poses: int) -> GravityRecording:
    names = recording.robot().robot.joint_names
    return GravityRecording(file=recording.label, role=role, poses=poses, **provenance(recording, names))
