"""The one judge: what an entry's predictions are worth on held-out data, whatever the entry is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daq.recording.commanded_motion import TARGET, commanded_motion
from daq.recording.recording import Recording
from daq.robot.loader import RobotFile
from drivers.core.arrays import BoolArray, FloatArray
from drivers.core.errors import DataError
from ident.assessment.validation import LOW_SPEED
from ident.benchmark.entry import ServoPredictor, TorquePredictor
from ident.benchmark.motion import BenchmarkMotion
from ident.estimators.feasible.pseudo_inertia import pseudo_inertia

DURATION = 0.3
"""[s] of a window."""

STEP = 0.002
"""[s] of the semi-implicit Euler steps."""

WINDOWS = 20
"""Windows of a motion at most, evenly spaced."""

LEAST_SPEED = 0.1
"""[rad/s or m/s] Some joint is at least so fast where a window begins."""

DIVERGED = 10.0
"""Error, as a multiple of the constant velocity's, from which a window has diverged."""


@dataclass(frozen=True)
class ForwardError:
    """Errors of simulated positions, under the measured torques and from measured states."""

    ratio: float  # median over the windows of the error over that of constant velocity; below 1 the model is of use
    diverged: float  # share of the windows beyond `DIVERGED`, or without an inertia matrix that can be inverted
    windows: int  # their number


def forward_error(predictor: TorquePredictor, motions: list[BenchmarkMotion]) -> ForwardError | None:
    """Simulate windows of held-out motions side by side; None where no joint moves.

    The inertia matrix and the other torques are taken from the predictor's torques, so that every model is simulated
    alike: M's columns are τ(q, 0, e_j) − τ(q, 0, 0), the rest is τ(q, q̇, 0).
    """
    ratios = [_window_ratios(predictor, motion) for motion in motions]
    every = np.concatenate(ratios)
    if not len(every):
        return None
    finite = np.where(np.isfinite(every), every, np.inf)
    return ForwardError(float(np.median(finite)), float(np.mean(finite > DIVERGED)), len(every))


def _window_ratios(predictor: TorquePredictor, motion: BenchmarkMotion) -> FloatArray:
    length = int(DURATION * motion.rate)
    first, last = motion.inner.start, motion.inner.stop - length
    fast = np.flatnonzero(np.max(np.abs(motion.dq), axis=1) >= LEAST_SPEED)
    fast = fast[(fast >= first) & (fast < last)]
    if not len(fast):
        return np.zeros(0)
    starts = fast[np.unique(np.linspace(0, len(fast) - 1, WINDOWS).astype(int))]
    time = np.arange(len(motion.q)) / motion.rate
    delays = np.broadcast_to(predictor.delay, motion.q.shape[1])
    columns = zip(motion.in_band(motion.torque).T, delays, strict=True)
    driving = np.stack([np.interp(time + delay, time, column) for column, delay in columns], axis=1)
    q, dq = motion.q[starts], motion.dq[starts]
    steps = int(DURATION / STEP)
    own, constant = np.zeros(len(starts)), np.zeros(len(starts))
    with np.errstate(all="ignore"):
        for step in range(1, steps + 1):
            seconds = starts / motion.rate + (step - 1) * STEP
            torque = _at(time, driving, seconds)
            acceleration = _acceleration(predictor, q, dq, torque)
            dq = dq + STEP * acceleration
            q = q + STEP * dq
            measured = _at(time, motion.q, seconds + STEP)
            own += np.mean(np.square(q - measured), axis=1)
            kept = motion.q[starts] + step * STEP * motion.dq[starts]
            constant += np.mean(np.square(kept - measured), axis=1)
        return np.sqrt(own / constant)


def _acceleration(predictor: TorquePredictor, q: FloatArray, dq: FloatArray, torque: FloatArray) -> FloatArray:
    """Accelerations (W, n); nan where the simulation has left every sensible state."""
    joints = q.shape[1]
    sane = np.all(np.isfinite(q) & np.isfinite(dq), axis=1) & (np.max(np.abs(dq), axis=1, initial=0.0) < 1e3)
    result = np.full_like(q, np.nan)
    if not sane.any():
        return result
    q, dq, count = q[sane], dq[sane], int(sane.sum())
    still = np.zeros_like(q)
    units = np.tile(np.eye(joints), (count, 1))
    positions = np.concatenate([q, q, np.repeat(q, joints, axis=0)])
    velocities = np.concatenate([dq, still, np.zeros_like(units)])
    accelerations = np.concatenate([still, still, units])
    torques = np.asarray(predictor.torque(positions, velocities, accelerations), dtype=np.float64)
    rest, level = torques[:count], torques[count : 2 * count]
    columns = torques[2 * count :].reshape(count, joints, joints) - level[:, None, :]
    matrices = columns.transpose(0, 2, 1)
    solved = [
        np.linalg.lstsq(matrix, right, rcond=None)[0] if np.all(np.isfinite(matrix)) else np.full(joints, np.nan)
        for matrix, right in zip(matrices, torque[sane] - rest, strict=True)
    ]
    result[sane] = solved
    return result


def _at(time: FloatArray, values: FloatArray, seconds: FloatArray) -> FloatArray:
    return np.stack([np.interp(seconds, time, column) for column in values.T], axis=1)


REST = 0.01
"""[rad/s or m/s] Below it a joint rests."""

BLOCKS = 10
"""Blocks of held-out time, from which errors' intervals are: neighbouring samples are not independent."""

POSES = 200
"""Random poses at which the inertia matrix is looked at."""

SETTLING = 1.0
"""[s] of a servo motion that do not count: its state at the beginning is unknown."""


@dataclass(frozen=True)
class JointError:
    """Root mean square errors of one joint's torque [N·m or N]; nan where there is no such sample."""

    joint: str  # its name
    torque: float  # root mean square of the torque itself, in the band
    band: float  # of torques low-passed at the data set's band
    raw: float  # of the samples as recorded
    rest: float  # in the band, below `REST`
    low_speed: float  # between `REST` and `LOW_SPEED`
    high_speed: float  # from there on


@dataclass(frozen=True)
class TorqueScore:
    """What torques on held-out data are worth."""

    relative_error: float  # ‖τ − τ̂‖ / ‖τ‖ in the band, over all joints, while the arm moves [%]
    raw_relative_error: float  # the same of the samples as recorded [%]
    # `relative_error`² over each block of held-out time, errors and torques: (2, blocks) sums [(N·m)²]
    blocks: tuple[tuple[float, ...], tuple[float, ...]]
    joints: tuple[JointError, ...]  # in the robot's order
    forward: ForwardError | None  # simulation under the measured torques; None where nothing moves
    links: int  # links of the model; 0 where it has no bodies
    consistent_links: int  # those whose mass density can exist (positive definite pseudo-inertia)
    positive_inertia: float  # share of random poses at which the inertia matrix is positive definite [%]
    samples: int  # that count


@dataclass(frozen=True)
class ServoScore:
    """What positions rolled out on held-out commands are worth."""

    rollout_error: float  # mean absolute error of the judged joints [mrad or mm], first second left out
    # its sums and numbers of samples over each recording: (2, recordings)
    blocks: tuple[tuple[float, ...], tuple[float, ...]]
    joints: dict[str, float]  # name → error [mrad or mm]
    samples: int  # that count


def judge_torques(predictor: TorquePredictor, motions: list[BenchmarkMotion], robot: RobotFile) -> TorqueScore:
    """Compare an entry's torques with held-out ones.

    Raises:
        DataError: the torques are not finite, or of another shape; or the arm never moves.
    """
    parts = [_compared(predictor, motion) for motion in motions]
    band, raw, torque, raw_torque, dq = (np.concatenate([window[index] for window in parts]) for index in range(5))
    speed = np.abs(dq)
    moving = np.any(speed >= REST, axis=1)
    if not moving.any():
        raise DataError("the arm does not move in the held-out data")
    names = robot.robot.joint_names
    joints = tuple(
        JointError(
            name,
            _rms(torque[:, joint]),
            _rms(band[:, joint]),
            _rms(raw[:, joint]),
            _rms(band[speed[:, joint] < REST, joint]),
            _rms(band[(speed[:, joint] >= REST) & (speed[:, joint] < LOW_SPEED), joint]),
            _rms(band[speed[:, joint] >= LOW_SPEED, joint]),
        )
        for joint, name in enumerate(names)
    )
    sums = [_blocks(np.sum(np.square(values), axis=1), moving) for values in (band, torque)]
    links, consistent = _bodies(predictor)
    return TorqueScore(
        100.0 * _relative(band[moving], torque[moving]),
        100.0 * _relative(raw[moving], raw_torque[moving]),
        (sums[0], sums[1]),
        joints,
        forward_error(predictor, motions),
        links,
        consistent,
        100.0 * _positive_share(predictor, robot),
        int(moving.sum()),
    )


def _compared(predictor: TorquePredictor, motion: BenchmarkMotion) -> tuple[FloatArray, ...]:
    """Errors in the band and raw, torques in the band and raw, and velocities, of the samples that count."""
    predicted = np.asarray(predictor.torque(motion.q, motion.dq, motion.ddq), dtype=np.float64)
    if predicted.shape != motion.torque.shape:
        raise DataError(f"the method's torques are {predicted.shape}; expected {motion.torque.shape}")
    if not np.all(np.isfinite(predicted)):
        raise DataError("the method's torques are not finite")
    time = np.arange(len(predicted)) / motion.rate
    delays = np.broadcast_to(predictor.delay, predicted.shape[1])
    columns = zip(predicted.T, delays, strict=True)
    predicted = np.stack([np.interp(time - delay, time, column) for column, delay in columns], axis=1)
    error, torque = predicted - motion.torque, motion.torque
    inner = motion.inner
    in_band = motion.in_band(np.concatenate([error, torque], axis=1))
    width = torque.shape[1]
    return in_band[inner, :width], error[inner], in_band[inner, width:], torque[inner], motion.dq[inner]


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")


def _relative(error: FloatArray, torque: FloatArray) -> float:
    return float(np.linalg.norm(error) / np.linalg.norm(torque))


def _blocks(values: FloatArray, used: BoolArray) -> tuple[float, ...]:
    return tuple(float(block.sum()) for block in np.array_split(values[used], BLOCKS))


def _bodies(predictor: TorquePredictor) -> tuple[int, int]:
    if predictor.bodies is None:
        return 0, 0
    eigenvalues = np.linalg.eigvalsh(pseudo_inertia(predictor.bodies))
    return len(predictor.bodies), int(np.sum(eigenvalues.min(axis=1) > 0.0))


def _positive_share(predictor: TorquePredictor, robot: RobotFile) -> float:
    """Share of poses within the limits at which M(q), from the torques, is positive definite."""
    limits = np.array([joint.position for joint in robot.robot.joints], dtype=np.float64)
    joints = len(limits)
    poses = np.random.default_rng(1).uniform(limits[:, 0], limits[:, 1], (POSES, joints))
    still, units = np.zeros_like(poses), np.tile(np.eye(joints), (POSES, 1))
    every = np.repeat(poses, joints, axis=0)
    level = np.asarray(predictor.torque(poses, still, still))
    columns = np.asarray(predictor.torque(every, np.zeros_like(every), units)).reshape(POSES, joints, joints)
    matrices = columns - level[:, None, :]
    symmetric = 0.5 * (matrices + matrices.transpose(0, 2, 1))
    return float(np.mean(np.linalg.eigvalsh(symmetric).min(axis=1) > 0.0))


def agreement(first: TorquePredictor, second: TorquePredictor) -> tuple[int, int] | None:
    """Number of parameters of two parts of the data, and of those whose difference has zero in its 95 % interval.

    None where there are none with intervals.
    """
    names = [name for name in first.parameters if name in second.parameters]
    if not names:
        return None
    pairs = [(first.parameters[name], second.parameters[name]) for name in names]
    inside = [abs(a - b) <= 1.96 * float(np.hypot(sa, sb)) for (a, sa), (b, sb) in pairs]
    return len(names), sum(inside)


def judge_servo(
    predictor: ServoPredictor, recordings: tuple[Recording, ...], robot: RobotFile, judged: list[str] | None
) -> ServoScore:
    """Roll out held-out commands from the measured start, and compare positions.

    Raises:
        DataError: the positions are not finite, or of another shape.
    """
    names = robot.robot.joint_names
    kept = [index for index, name in enumerate(names) if judged is None or name in judged]
    sums, counts, errors = [], [], []
    for recording in recordings:
        recorded = commanded_motion(recording, robot.robot)
        command = recorded.commands[TARGET]
        given = np.asarray(predictor.roll_out(recorded.command_time, command, recorded.position[0]), dtype=np.float64)
        if given.shape != command.shape or not np.all(np.isfinite(given)):
            raise DataError(f"the method's positions {given.shape} are not finite ones of shape {command.shape}")
        time = recorded.time
        counted = (time >= time[0] + SETTLING) & (time <= recorded.command_time[-1])
        at = np.stack([np.interp(time, recorded.command_time, column) for column in given.T], axis=1)
        absolute = 1e3 * np.abs(at - recorded.position)[counted][:, kept]
        errors.append(absolute)
        sums.append(float(absolute.mean(axis=1).sum()))
        counts.append(float(len(absolute)))
    every = np.concatenate(errors)
    joints = {names[index]: float(value) for index, value in zip(kept, every.mean(axis=0), strict=True)}
    return ServoScore(float(every.mean()), (tuple(sums), tuple(counts)), joints, len(every))
