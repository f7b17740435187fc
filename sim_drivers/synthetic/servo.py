"""Recordings of a simulated servo arm: commands in, encoder out."""

from __future__ import annotations

from datetime import UTC, datetime
from os import PathLike
from pathlib import Path

import numpy as np

from daq.motion.trajectories import Motion
from daq.motion.trajectory_file import load_trajectory
from daq.output_files import check_outputs
from daq.recording.recording import JOINTS_STREAM, Channel, Recording, Stream
from daq.recording.writer import write_recording
from daq.robot.loader import RobotFile, load_robot
from daq.robot.schema import TruthServo
from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from drivers.core.options import check_kind
from drivers.core.software import software_versions
from drivers.streams import UNITS
from ident.servo.rollout.goals import UNLIMITED
from sim_drivers.plant.sensors import quantised
from sim_drivers.plant.servo import ServoArm, true_servos

REACH = 0.45
"""[rad or m] of the commands about the middle of the range, at most."""

TONES = 4
"""Sines of a joint's slow motion."""

PARTS = 4
"""Parts of a step that is divided between two commands."""


def simulate_servo(
    robot: str | Path | RobotFile,
    duration: float = 30.0,
    seed: int = 0,
    rate: float | None = None,
    motion: str | PathLike[str] | None = None,
) -> Recording:
    """Record a simulated servo arm: slow sines, steps and a chirp to 3 Hz of all joints, a third of the time each.

    The recording holds `position`, quantised by the encoder, and `target_position`; `temperature` of the housings where
    the truth's drives depend on it; no current and no torque.

    Args:
        robot: built-in name, robot file whose `truth.joints` have a `servo`, or the result of `load_robot`.
        duration: of the recording [s].
        seed: of the commands, and of when they come.
        rate: of commands and samples [Hz]; the robot file's where absent.
        motion: trajectory file that is played in place of the commands above.

    Raises:
        RobotFileError: no such robot, or its truth has no servos.
        UsageError: a duration or a rate that is not positive, or a motion of another arm.

    Example:
        >>> import dynid
        >>> run = dynid.simulate_servo("so101", duration=4.0, seed=1)
        >>> sorted(run.streams["joints"].channels)
        ['position', 'target_position']
    """
    for name, value in (("duration", duration), ("rate", rate)):
        check_kind(name, "float | None", value)
        if value is not None and not 0 < value < float("inf"):
            raise UsageError(f"{name} {value:g} is not a positive number")
    file = load_robot(robot)
    true_servos(file.robot, file.where)
    noise = file.robot.truth.noise
    frequency = noise.rate if rate is None else rate
    if motion is None:
        time = np.arange(max(2, round(duration * frequency))) / frequency
        command = servo_commands(file, time, seed)
    else:
        played: Motion = load_trajectory(Path(motion), file.robot).motion
        time = np.arange(max(2, round(played.duration * frequency) + 1)) / frequency
        command = played.evaluate(np.minimum(time, played.duration))[0].T.copy()
    return record_servo(file, time, command, seed)


def record_servo(
    file: RobotFile, time: FloatArray, command: FloatArray, seed: int, celsius: float | None = None
) -> Recording:
    """Record a simulated servo arm on commands (N, n) [rad or m] that are held between their times (N,) [s].

    The seed is that of the commands' jitter; windings and housings have `celsius` at first, the ambient temperature
    where None.

    Raises:
        RobotFileError: a joint has no true servo.
    """
    noise, names = file.robot.truth.noise, file.robot.joint_names
    position, housing = simulated_servo(file, time, command, seed, celsius)
    unit = file.robot.column_unit(UNITS["position"], names)
    position = quantised(position, noise.encoder_resolution)
    channels = {
        "position": Channel("position", position, unit, names, "simulated encoder"),
        "target_position": Channel("target_position", command, unit, names, "commands of a simulated arm"),
    }
    if any(s.resistance_slope or s.torque_slope or s.viscous_slope for s in true_servos(file.robot, file.where)):
        shown = quantised(housing, noise.temperature_resolution)
        channels["temperature"] = Channel("temperature", shown, UNITS["temperature"], names, "simulated sensor")
    return Recording(
        robot_text=file.text,
        urdf_text=file.urdf_text or "",
        streams={JOINTS_STREAM: Stream(JOINTS_STREAM, time, time, channels)},
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        versions=software_versions(),
        comment=f"simulated servos, seed {seed}",
    )


def play_and_record(robot: str, motion: Path | None, out: Path | None, seed: int, *, overwrite: bool) -> None:
    """Play a motion on a simulated servo arm, and write the recording: `dynid sim ROBOT --play MOTION -o RUN.h5`.

    Raises:
        UsageError: one of both paths is missing, the recording exists, or the motion is of another arm.
        RobotFileError: the robot's truth has no servos.
    """
    if motion is None or out is None:
        given, missing = ("--out", "--play") if motion is None else ("--play", "--out")
        raise UsageError(f"{given} needs {missing}", hint="dynid sim so101 --play motion.yaml -o run.h5")
    file = load_robot(robot)
    check_outputs([out], [*file.files, motion], overwrite=overwrite)
    run = simulate_servo(file, seed=seed, motion=motion)
    write_recording(out, run, overwrite=overwrite)
    print(f"{out}: {len(run.streams[JOINTS_STREAM].time)} samples of position and target_position")


def servo_commands(file: RobotFile, time: FloatArray, seed: int) -> FloatArray:
    """Commands (N, n) [rad or m] within the joints' limits."""
    generator = np.random.default_rng(seed)
    joints, end = file.robot.joints, float(time[-1])
    commands = np.empty((len(time), len(joints)))
    slow, steps = time < end / 3, (time >= end / 3) & (time < 2 * end / 3)
    for joint, limits in enumerate(joints):
        low, high = limits.position
        middle = float(np.clip(0.0, low + 0.2 * (high - low), high - 0.2 * (high - low)))
        reach = min(REACH, 0.4 * (high - low))
        phases, shares = generator.uniform(0, 2 * np.pi, TONES), generator.dirichlet(np.ones(TONES))
        rates = 2 * np.pi * generator.uniform(0.05, 0.4, TONES)
        sines = np.sin(rates * time[:, None] + phases) @ shares
        held = np.repeat(generator.uniform(-1, 1, 64), 1)[np.minimum((time / 1.7).astype(int), 63)]
        sweep = 0.4 * np.sin(2 * np.pi * 4.5 / end * np.maximum(time - 2 * end / 3, 0.0) ** 2 + phases[0])
        commands[:, joint] = middle + reach * np.where(slow, sines, np.where(steps, held, sweep))
    return commands


def simulated_servo(
    file: RobotFile, time: FloatArray, command: FloatArray, seed: int = 0, celsius: float | None = None
) -> tuple[FloatArray, FloatArray]:
    """Positions and housing temperatures (N, n) of the true arm on commands (N, n), held between their times (N,).

    Raises:
        RobotFileError: a joint has no true servo.
    """
    arm = ServoArm(file, command[0].copy(), celsius)
    count = int(np.ceil(time[-1] / arm.step)) + 1
    arrived = _arrived(true_servos(file.robot, file.where), time, seed)
    goals = _goals(true_servos(file.robot, file.where), arrived, command, count, arm.step)
    path, warmth = np.empty((count, command.shape[1])), np.empty((count, command.shape[1]))
    for index in range(count):
        path[index], warmth[index] = arm.position, arm.heat.housing
        arm.advance(goals[index])
    grid = np.arange(count) * arm.step
    return tuple(np.stack([np.interp(time, grid, column) for column in rows.T], axis=1) for rows in (path, warmth))  # type: ignore[return-value]


def _arrived(servos: list[TruthServo], time: FloatArray, seed: int) -> FloatArray:
    """(N, n) when each command takes effect [s]: all servos are late by the same part of their jitter."""
    late = np.random.default_rng([seed, 1]).uniform(0.0, 1.0, len(time))
    return np.stack([time + servo.delay + servo.jitter * late for servo in servos], axis=1)


def _goals(servos: list[TruthServo], arrived: FloatArray, command: FloatArray, count: int, step: float) -> FloatArray:
    """Means (count, `PARTS`, n) over parts of each step of the profiles, which stop at the latest command in time."""
    goals = np.empty((count, PARTS, len(servos)))
    times = (np.arange(count * PARTS) + 0.5) * step / PARTS
    for joint, servo in enumerate(servos):
        goal, pace, most = float(command[0, joint]), 0.0, servo.acceleration * step
        # A command that a later one overtakes has no effect.
        order = np.argsort(arrived[:, joint], kind="stable")
        newest = np.maximum.accumulate(order)
        latest = np.searchsorted(arrived[order, joint], times, side="right") - 1
        chosen = np.where(latest < 0, 0, newest[np.maximum(latest, 0)])
        goals[:, :, joint] = command[chosen, joint].reshape(count, PARTS)
        if servo.acceleration >= UNLIMITED:
            continue
        before = goal
        for index, target in enumerate(goals[:, :, joint].mean(axis=1).tolist()):
            distance = abs(target - goal)
            speed = min((2 * servo.acceleration * distance + most**2 / 4) ** 0.5 - most / 2, distance / step)
            pace = min(max(speed if target > goal else -speed, pace - most), pace + most)
            goal += step * pace
            after = goal - 0.5 * step * pace  # the sum is half a step ahead of the profile
            goals[index, :, joint] = 0.5 * (before + after)
            before = after
    return goals
