"""Identification of servo arms: recordings in, result out; and the same model on other recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from daq.recording.commanded_motion import commanded_motion
from daq.recording.quality.quantisation import resolution
from daq.recording.quality.stale_samples import stale_rows
from daq.recording.recording import Recording
from daq.robot.loader import RobotFile
from daq.robot.schema import Robot
from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError, IdentificationError
from drivers.core.reading_process import Progress
from drivers.core.text import percent_text, rounded
from ident.assessment.command_checks import refuse_unusable_commands
from ident.identify.summary import provenance
from ident.model.another_arm import check_arm
from ident.result.graded import Grade, robots_of
from ident.servo.arm_rollout import command_paths, delay_and_lag, delayed_paths, rollout_errors, touched_paths
from ident.servo.contact import PRESSING, ServoContact, tool_point
from ident.servo.fit import ServoFit, fit_servo
from ident.servo.lapses import lapses
from ident.servo.links import ServoLinks, servo_links
from ident.servo.motion import ServoMotion, servo_motions
from ident.servo.result import (
    ContactSegment,
    References,
    RolloutError,
    RolloutFit,
    ServoJoint,
    ServoParameter,
    ServoRecording,
    ServoResult,
)
from ident.servo.simulators.mjcf import model_paths, read_model_file
from ident.servo.terms import INDEX, TERMS
from ident.signals.sample_hashes import SAME_DATA, HashArray, check_counted_once, overlap, sample_hashes

HELD_OUT = 0.3
"""Share at the end of each recording that validates, where no other recording does."""

MOST_SHOWN = 3
"""Rests and jumps of a recording's positions that the verdict lists."""

PAUSE = 0.5
"""[s] without contact between two contacts."""

FAR_ZERO = 0.15
"""[rad or m] of an encoder's zero against that of the URDF that is named."""

ROUNDED, UNEXPLAINED = 0.25, 0.5
"""Median errors in encoder steps that rounding leaves, and beyond which a model lacks something (0.17 to 0.35 in
simulated arms as they are, 0.55 to 3.7 in an OpenArm with play)."""

GOOD, USABLE = 3.0, 8.0
"""Roll-out errors in encoder steps below which a model is good and usable, where it also beats delay and lag."""

FINE_STEP = 1e-3
"""[rad or m] Encoder steps finer than this make no model worse: they count as this."""


@dataclass(frozen=True, eq=False)
class ServoIdentification:
    """What an identification gives."""

    result: ServoResult  # as result.json holds it
    motions: list[ServoMotion]  # that were held out, or those of the fit where none were
    paths: list[FloatArray]  # their roll-outs (N, n) [rad or m]


def identify_servo(
    recordings: Sequence[Recording],
    held_out: Sequence[Recording],
    robot_file: RobotFile | None,
    given: dict[str, dict[str, float]],
    progress: Progress,
    model_file: Path | None = None,
) -> ServoIdentification:
    """Identify an arm of servos from commanded and measured positions.

    Args:
        recordings: of one arm.
        held_out: that validate; the last 30 % of each of the others where there are none.
        robot_file: in place of the recordings' own.
        given: joint → parameter → known value.
        progress: called with the name of each step.
        model_file: an MJCF of the arm as it came, whose roll-out the errors stand beside.

    Raises:
        DataError: a recording has no commands, or its positions do not follow them.
        UsageError: the samples of one recording are another's.
        RobotFileError: a link's mass is not known.
        IdentificationError: no joint moves.
        UsageError, ModelError: the MJCF cannot be rolled out.
    """
    if not recordings:
        raise DataError("no recording to identify from")
    file = robot_file or recordings[0].robot()
    if robot_file is None:
        check_arm([*recordings[1:], *held_out], file)
    robot, links = file.robot, servo_links(file)
    reference = None if model_file is None else read_model_file(model_file, robot.joint_names)
    progress("reading commands")
    parts = [read_motions(recording, file) for recording in recordings]
    used = check_counted_once(
        [recording.label for recording in recordings], [_hashes(part) for part in parts], SAME_DATA
    )
    motions = [motion for part in parts for motion in part]
    if held_out:
        judged = [motion for recording in held_out for motion in read_motions(recording, file)]
        source = "recordings of their own"
    else:
        motions, judged = _divided(motions)
        source = f"the last {HELD_OUT:.0%} of each recording"
    steps = _encoder_steps(motions)
    moving = np.array([max(np.ptp(motion.command[:, joint]) for motion in motions) for joint in range(robot.dof)])
    if not np.any(moving > 5 * steps):
        raise IdentificationError("no joint is commanded to move by more than five encoder steps")
    tool = tool_point(file, links)
    known, declared = (_given(terms, robot.joint_names) for terms in (given, _declared(robot)))
    declared = {key: value for key, value in declared.items() if key not in known}
    fitted = fit_servo(motions, links, steps, known, declared, tool, progress)
    progress("roll-out")
    lag = delay_and_lag(motions)
    contact = fitted.contact
    fit, _ = judge(motions, links, fitted.values, lag, contact, None, held_out=False)
    own = not (held_out and _uses(judged, used))
    validation, paths = judge(judged, links, fitted.values, lag, contact, reference, held_out=own)
    doubts = _doubts([*recordings, *held_out], file)
    doubts += unexplained(robot.joint_names, np.where(fitted.moving, fitted.left / steps, 0.0))
    wrong = [joint for joint, name in declared if not fitted.held[joint, INDEX[name]]]
    if np.any(fitted.moving[wrong]):
        limit = next(iter(declared.values()))
        doubts.append(
            f"the recordings contradict the profile of {limit:g} rad/s² that `connections` sets in the servos"
        )
    if len(recordings) > 1 and fit.rollout_mean > USABLE * steps.mean():
        doubts.append(
            f"the recordings do not follow one model ({rounded(1e3 * fit.rollout_mean)} mrad in their own data): if "
            "gains, load or mounting changed between them, identify each alone (dynid diff compares the models)"
        )
    joints = [_joint(fitted, row, name, links.model.sliding[row]) for row, name in enumerate(robot.joint_names)]
    result = ServoResult.of(
        file,
        sliding=list(links.model.sliding),
        links=links.origin,
        resolution=steps.tolist(),
        step=motions[0].step,
        servo=joints,
        contact=contact,
        covariance=[matrix.tolist() for matrix in fitted.covariance],
        searched=[[TERMS[index].name for index in np.flatnonzero(row)] for row in fitted.free],
        fit=fit,
        validation=validation,
        validation_source=source,
        recordings=[
            *(_use(recording, file, "identification", kept) for recording, kept in zip(recordings, used, strict=True)),
            *(_use(recording, file, "validation", []) for recording in held_out),
        ],
        verdict=verdict(robot.joint_names, joints, validation, steps, contact, doubts),
    )
    return ServoIdentification(result, judged, paths)


def revalidate_servo(
    result: ServoResult, recordings: Sequence[Recording], robot_file: RobotFile, model_file: Path | None = None
) -> ServoIdentification:
    """The same model on other recordings: `validation` and `verdict` are theirs.

    Args:
        result: of the model.
        recordings: of the same arm.
        robot_file: of the result.
        model_file: an MJCF of the arm as it came, whose roll-out the errors stand beside.

    Raises:
        UsageError, ModelError: the MJCF cannot be rolled out.
        DataError: a recording has no commands, or is of another arm.
    """
    check_arm(recordings, robot_file, robots_of(result.recordings))
    links = servo_links(robot_file)
    reference = None if model_file is None else read_model_file(model_file, result.joints)
    motions = [motion for recording in recordings for motion in read_motions(recording, robot_file)]
    held_out = not _uses(motions, [use.sample_hashes for use in result.recordings if use.role == "identification"])
    lag = delay_and_lag(motions)
    contact = result.contact
    fit, paths = judge(motions, links, result.values, lag, contact, reference, held_out=held_out)
    steps = np.array(result.resolution)
    doubts = _doubts(recordings, robot_file)
    changed = result.model_copy(
        update={
            "validation": fit,
            "validation_source": "recordings of their own",
            "verdict": verdict(tuple(result.joints), result.servo, fit, steps, contact, doubts),
        }
    )
    return ServoIdentification(changed, motions, paths)


def read_motions(recording: Recording, robot_file: RobotFile) -> list[ServoMotion]:
    """The motions of a recording, after its commands were compared with what the arm did.

    Raises:
        DataError: they do not belong together; says why, and what to do.
    """
    stale = stale_rows(recording)
    for jump in () if stale is None else stale.jumps:
        if jump.cause == "turn":
            raise DataError(
                f"the position of {jump.joint} jumps by a full turn at {jump.time:.2f} s, as for wrapped angles",
                where=recording.label,
                hint="continue the angle there (numpy.unwrap) and import it again",
            )
    recorded = commanded_motion(recording, robot_file.robot)
    refuse_unusable_commands(recorded, recording.label)
    return servo_motions(recorded, recording.label)


def _doubts(recordings: Sequence[Recording], robot_file: RobotFile) -> list[str]:
    """Return which samples of recordings are not what they say, in words; the fit has them all."""
    doubts = []
    for recording in recordings:
        stale = stale_rows(recording)
        if stale is None:
            continue
        repeats = stale.repeated | stale.held
        if repeats.any():
            share = percent_text(float(np.mean(repeats)), 2)
            doubts.append(f"{recording.label}: {share} of the positions repeat the one before while the arm moves")
        for encoder in stale.encoders[:MOST_SHOWN]:
            doubts.append(
                f"{recording.label}: the position of {encoder.joint} rests from {encoder.start:.1f} to "
                f"{encoder.stop:.1f} s while its target moves: a stop, a limit of the servo, or its encoder"
            )
        for jump in stale.jumps[:MOST_SHOWN]:
            doubts.append(
                f"{recording.label}: the position of {jump.joint} jumps by {jump.size:.2g} at {jump.time:.2f} s: its "
                "encoder lost its zero, or rows are missing"
            )
        named = {encoder.joint for encoder in stale.encoders}
        doubts += [
            f"{recording.label}: {lapse}" for lapse in lapses(commanded_motion(recording, robot_file.robot), named)
        ]
    return doubts


def unexplained(names: Sequence[str], errors: FloatArray) -> list[str]:
    """Return which joints' median errors (n,) [encoder steps] show that the model lacks something."""
    lacking = [f"{name} {error:.2g}" for name, error in zip(names, errors, strict=True) if error > UNEXPLAINED]
    if not lacking:
        return []
    return [
        f"errors of {', '.join(lacking)} encoder steps in the fitted pieces (median; rounding alone leaves {ROUNDED}): "
        "the model lacks play, friction or flexibility, or the URDF's links are wrong, and intervals do not cover what "
        "these bias"
    ]


def judge(
    motions: Sequence[ServoMotion],
    links: ServoLinks,
    values: FloatArray,
    lag: tuple[float, float],
    contact: ServoContact | None,
    reference: Any | None,
    *,
    held_out: bool,
) -> tuple[RolloutFit, list[FloatArray]]:
    """Roll-out errors of motions beside the references, and the paths."""
    found = touched_paths(motions, links, values, contact)
    paths = [path for path, _ in found]
    errors = rollout_errors(motions, paths)
    command = rollout_errors(motions, command_paths(motions))
    lagged = rollout_errors(motions, delayed_paths(motions, *lag))
    seconds = np.array([motion.time[-1] for motion in motions])
    of_file = None if reference is None else rollout_errors(motions, model_paths(reference, links, motions))
    labels = list(dict.fromkeys(motion.label for motion in motions))

    def mean(rows: FloatArray) -> list[float]:
        return [float(value) for value in np.average(rows, axis=0, weights=seconds)]

    own = {label: [row for row, motion in enumerate(motions) if motion.label == label] for label in labels}
    return (
        RolloutFit(
            rollout_error=mean(errors),
            rollout_mean=float(np.mean(mean(errors))),
            references=References(
                command=mean(command), delay_and_lag=mean(lagged), model_file=None if of_file is None else mean(of_file)
            ),
            recordings=[
                RolloutError(
                    recording=label, rollout_error=np.average(errors[rows], axis=0, weights=seconds[rows]).tolist()
                )
                for label, rows in own.items()
            ],
            contacts=[
                segment
                for motion, (_, force) in zip(motions, found, strict=True)
                for segment in _contact_segments(motion, force)
            ],
            held_out=held_out,
            seconds=float(seconds.sum()),
        ),
        paths,
    )


def _contact_segments(motion: ServoMotion, force: FloatArray) -> list[ContactSegment]:
    """When a motion's roll-out touches something; pauses below `PAUSE` do not count."""
    times = motion.time[force > PRESSING]
    if not len(times):
        return []
    ends = np.flatnonzero(np.diff(times) > PAUSE)
    begins = np.concatenate([[0], ends + 1])
    return [
        ContactSegment(
            recording=motion.label,
            begin=motion.begin + float(times[first]),
            end=motion.begin + float(times[last]),
            force=float(force[(motion.time >= times[first]) & (motion.time <= times[last])].max()),
        )
        for first, last in zip(begins, [*ends, len(times) - 1], strict=True)
    ]


def verdict(
    names: Sequence[str],
    joints: Sequence[ServoJoint],
    judged: RolloutFit,
    steps: FloatArray,
    contact: ServoContact | None = None,
    doubts: Sequence[str] = (),
) -> Grade:
    """A grade for rolling out motions, by held-out errors against encoder steps and references."""
    error, lagged = np.array(judged.rollout_error), np.array(judged.references.delay_and_lag)
    worse = [name for name, own, other in zip(names, error, lagged, strict=True) if own > other + 0.5 * steps.mean()]
    mean, step = float(error.mean()), float(steps.mean())
    gain = float(lagged.mean()) / mean if mean > 0 else np.inf
    unit = max(step, FINE_STEP)
    grade: Literal["good", "usable", "poor"] = (
        "good" if mean < GOOD * unit else "usable" if mean < USABLE * unit or gain > 3 else "poor"
    )
    if gain < 1.2 or worse:
        grade = "poor" if gain < 1 else "usable" if grade == "good" else grade
    if not judged.held_out and grade == "good":
        grade = "usable"
    checks = list(doubts)
    zeros = {joint.joint: joint.parameters["zero"].value for joint in joints if "zero" in joint.parameters}
    far = [f"{name} by {value:.2g} rad" for name, value in zeros.items() if abs(value) > FAR_ZERO]
    if far:
        checks.append(
            f"gravity shows another encoder zero than the URDF's: {', '.join(far)}; compare a pose of the arm with its "
            "model: zeros, signs and order of the joints, and its mounting"
        )
    if contact is not None:
        checks.append(_contact_words(contact, judged.contacts))
    if worse:
        checks.append(f"{', '.join(worse)}: no better than one delay and lag for all joints")
    limited = [
        f"{joint.joint} at {limit.value:.3g} {limit.unit}"
        for joint in joints
        if (limit := joint.parameters.get("torque_limit")) is not None and limit.origin == "data"
    ]
    if limited:
        checks.append(f"drives that saturate: {', '.join(limited)}; beyond it a joint no longer follows its commands")
    resting = [joint.joint for joint in joints if joint.note]
    if resting:
        checks.append(f"{', '.join(resting)}: never commanded to move, so all its parameters are those of the others")
    loose = [joint.joint for joint in joints if joint.parameters["stiffness"].origin == "assumed" and not joint.note]
    if loose:
        checks.append(
            f"{', '.join(loose)}: nothing ties the torques to N·m (no gravity, or too little motion); the stiffness is "
            "that of the other joints, and their inertia and friction scale with it"
        )
    if not judged.held_out:
        checks.append("not held out: these data are in the identification")
    reach = (
        f"roll-out error {rounded(1e3 * mean)} mrad ({rounded(mean / step)} encoder steps), {rounded(gain)} times less "
        "than with one delay and lag"
    )
    return Grade(grade=grade, headline=f"{grade.capitalize()} for simulation: {reach}.", checks=checks)


def _contact_words(contact: ServoContact, segments: Sequence[ContactSegment]) -> str:
    """Return what the arm touches, and when."""
    text = f"the arm touches something at a height of {contact.height:.3f} m"
    if not segments:
        return f"{text} in other motions; the joints are fitted without these times"
    longest = max(segments, key=lambda segment: segment.end - segment.begin)
    seconds = sum(segment.end - segment.begin for segment in segments)
    others = f" and {len(segments) - 1} more times" if len(segments) > 1 else ""
    return (
        f"{text}: in {longest.recording} from {longest.begin:.1f} s to {longest.end:.1f} s{others}, {seconds:.0f} s in "
        "all; the joints are fitted without such times"
    )


def _joint(fitted: ServoFit, row: int, name: str, sliding: bool) -> ServoJoint:
    parameters = {}
    for index, term in enumerate(TERMS):
        free, held = bool(fitted.free[row, index]), bool(fitted.held[row, index])
        if not free and not held:
            continue
        unit = term.unit.replace("N·m/rad", "N/m").replace("N·m·s/rad", "N·s/m") if sliding else term.unit
        if sliding:
            unit = {"N·m": "N", "kg·m²": "kg", "rad": "m", "rad/s": "m/s", "rad/s²": "m/s²"}.get(unit, unit)
        parameters[term.name] = ServoParameter(
            value=float(fitted.values[row, index]),
            unit=unit,
            interval=(float(fitted.low[row, index]), float(fitted.high[row, index])) if free else None,
            unidentifiable=(free and not bool(fitted.seen[row, index])) or (held and (row, index) in fitted.assumed),
            origin="data" if free else "assumed" if (row, index) in fitted.assumed else "given",
        )
    note = "" if fitted.moving[row] else "does not move in these recordings"
    return ServoJoint(joint=name, parameters=parameters, kept=dict(fitted.gains[row]), note=note)


def _given(given: dict[str, dict[str, float]], names: Sequence[str]) -> dict[tuple[int, str], float]:
    return {(list(names).index(joint), term): value for joint, terms in given.items() for term, value in terms.items()}


def _declared(robot: Robot) -> dict[str, dict[str, float]]:
    """Limits of the servos' profiles that the robot file's connections set (`acceleration`), where these agree."""
    name, allowed = "acceleration_limit", TERMS[INDEX["acceleration_limit"]].allowed
    stated = [(connection.model_extra or {}).get("acceleration") for connection in robot.connections.values()]
    limits = {float(each) for each in stated if isinstance(each, (int, float)) and allowed.holds(each)}
    return {joint: {name: limit} for limit in limits for joint in robot.joint_names if len(limits) == 1}


def _divided(motions: Sequence[ServoMotion]) -> tuple[list[ServoMotion], list[ServoMotion]]:
    """The first part of each motion, and the rest."""
    first, last = [], []
    for motion in motions:
        cut = int(np.searchsorted(motion.time, (1 - HELD_OUT) * motion.time[-1]))
        first.append(motion.between(0, cut))
        last.append(motion.between(cut, len(motion.time)))
    return first, last


def _encoder_steps(motions: Sequence[ServoMotion]) -> FloatArray:
    """(n,) [rad or m]; that of the other joints where one does not move."""
    steps = []
    for joint in range(motions[0].position.shape[1]):
        step = resolution(np.concatenate([motion.position[:, joint] for motion in motions]))
        steps.append(step if np.isfinite(step) and step > 0 else np.nan)
    known = np.array(steps)
    common = float(np.nanmedian(known)) if np.isfinite(known).any() else 1e-5
    return np.maximum(np.where(np.isfinite(known), known, common), 1e-6)


def _use(recording: Recording, file: RobotFile, role: str, kept: list[int]) -> ServoRecording:
    recorded = commanded_motion(recording, file.robot)
    seconds = float(recorded.time[-1] - recorded.time[0])
    return ServoRecording.model_validate(
        {
            "file": recording.label,
            "role": role,
            **provenance(recording, file.robot.joint_names),
            "sample_hashes": kept,
            "seconds": seconds,
            "rate_hz": (len(recorded.time) - 1) / seconds,
        }
    )


def _hashes(motions: Sequence[ServoMotion]) -> HashArray:
    """Hashes of the measured positions and their changes: other runs of a motion share few of them."""
    each = [sample_hashes(motion.position[1:], np.diff(motion.position, axis=0)) for motion in motions]
    return np.unique(np.concatenate(each)) if each else np.zeros(0, dtype=np.uint64)


def _uses(motions: Sequence[ServoMotion], used: Sequence[Sequence[int]]) -> bool:
    """Whether the samples of some motion are in recordings of which hashes were kept."""
    return any(overlap(_hashes([motion]), used) >= 1.0 for motion in motions)
