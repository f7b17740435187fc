"""Recordings of a simulated servo arm: commands and encoder, all joints coupled, dry friction exact in every step."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from daq.recording.recording import JOINTS_STREAM, Channel, Recording, Stream, software_versions
from daq.robot.loader import RobotFile, load_robot
from daq.robot.schema import TruthJoint, TruthServo
from drivers.core.arrays import FloatArray
from drivers.core.errors import RobotFileError, UsageError
from drivers.streams import UNITS
from ident.model.rigid_arm import rigid_arm
from ident.model.true_parameters import true_model, truth_vector
from ident.simulation.dry_friction import dry_friction

STEP = 0.002
"""[s] of the simulation."""

REACH = 0.45
"""[rad or m] of the commands about the middle of the range, at most."""

TONES = 4
"""Sines of a joint's slow motion."""


def simulate_servo(
    robot: str | Path | RobotFile, duration: float = 30.0, seed: int = 0, rate: float | None = None
) -> Recording:
    """Record a simulated servo arm: slow sines, steps and a chirp to 3 Hz of all joints, a third of the time each.

    The recording holds `position`, quantised by the encoder, and `target_position`; no current and no torque.

    Args:
        robot: built-in name, robot file whose `truth.joints` have a `servo`, or the result of `load_robot`.
        duration: of the recording [s].
        seed: of the commands.
        rate: of commands and samples [Hz]; the robot file's where absent.

    Raises:
        RobotFileError: no such robot, or its truth has no servos.
        UsageError: a duration or a rate that is not positive.

    Example:
        >>> import dynid
        >>> run = dynid.simulate_servo("so101", duration=4.0, seed=1)
        >>> sorted(run.streams["joints"].channels)
        ['position', 'target_position']
    """
    for name, value in (("duration", duration), ("rate", rate)):
        if value is not None and not 0 < value < float("inf"):
            raise UsageError(f"{name} {value:g} is not a positive number")
    file = load_robot(robot)
    noise = file.robot.truth.noise
    frequency = noise.rate if rate is None else rate
    time = np.arange(max(2, round(duration * frequency))) / frequency
    command = servo_commands(file, time, seed)
    position = simulated_servo(file, time, command)
    if noise.encoder_resolution > 0:
        position = np.round(position / noise.encoder_resolution) * noise.encoder_resolution
    names = file.robot.joint_names
    unit = file.robot.column_unit(UNITS["position"], names)
    channels = {
        "position": Channel("position", position, unit, names, "simulated encoder"),
        "target_position": Channel("target_position", command, unit, names, "commands of a simulated arm"),
    }
    return Recording(
        robot_text=file.text,
        urdf_text=file.urdf_text or "",
        streams={JOINTS_STREAM: Stream(JOINTS_STREAM, time, time, channels)},
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        versions=software_versions(),
        comment=f"simulated servos, seed {seed}",
    )


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


def simulated_servo(file: RobotFile, time: FloatArray, command: FloatArray) -> FloatArray:
    """Positions (N, n) of the true arm on commands (N, n) that are held between their times (N,).

    Raises:
        RobotFileError: a joint has no true servo.
    """
    robot = file.robot
    truths = [robot.truth.joints.get(name, TruthJoint()) for name in robot.joint_names]
    servos = [truth.servo for truth in truths if truth.servo is not None]
    if len(servos) < len(truths):
        raise RobotFileError("some joint has no servo", where=f"{file.where}: truth.joints")
    model = true_model(file)
    inertial = truth_vector(file, model)[: 10 * len(model.joints)]
    arm = rigid_arm(model, inertial, np.array([truth.motor_inertia for truth in truths]))
    damping = np.array([truth.viscous for truth in truths])
    coulomb = np.array([truth.coulomb for truth in truths])
    breakaway = np.array([truth.stribeck for truth in truths])
    fading = np.array([truth.stribeck_velocity for truth in truths])

    def of(name: str) -> FloatArray:
        return np.array([getattr(servo, name) for servo in servos], dtype=np.float64)

    stiffness, limit, share, bias = of("stiffness"), of("torque_limit"), of("load_friction"), of("bias")
    count = int(np.ceil(time[-1] / STEP)) + 1
    targets = _targets(servos, time, command, count)
    position, velocity = command[0].copy(), np.zeros(len(truths))
    guess, path = np.zeros(len(truths)), np.empty((count, len(truths)))
    for index in range(count):
        path[index] = position
        linear = stiffness * (targets[index] - position - bias)
        torque = np.clip(linear, -limit, limit)
        acting = np.where(np.abs(linear) < limit, stiffness, 0.0)
        matrix = arm.inertia(position) + np.diag(STEP * damping + STEP**2 * acting)
        momentum = arm.inertia(position) @ velocity + STEP * (torque - arm.bias(position, velocity))
        free = np.linalg.solve(matrix, momentum)
        friction = coulomb + share * np.abs(torque) + breakaway * np.exp(-((velocity / fading) ** 2))
        response = np.asarray(STEP * np.linalg.inv(matrix), dtype=np.float64)
        guess = dry_friction(response, free, np.maximum(friction, 1e-9), guess)
        velocity = free - response @ guess
        position = position + STEP * velocity
    grid = np.arange(count) * STEP
    return np.stack([np.interp(time, grid, column) for column in path.T], axis=1)


def _targets(servos: list[TruthServo], time: FloatArray, command: FloatArray, count: int) -> FloatArray:
    """Goals (count, n) of the servos' profiles, which stop at the delayed command as fast as they may."""
    goals = np.empty((count, len(servos)))
    for joint, servo in enumerate(servos):
        goal, pace, most = float(command[0, joint]), 0.0, servo.acceleration * STEP
        latest = np.searchsorted(time, np.arange(1, count + 1) * STEP - servo.delay, side="right") - 1
        for index, target in enumerate(command[np.clip(latest, 0, len(time) - 1), joint].tolist()):
            distance = abs(target - goal)
            speed = min((2 * servo.acceleration * distance + most**2 / 4) ** 0.5 - most / 2, distance / STEP)
            pace = min(max(speed if target > goal else -speed, pace - most), pace + most)
            goal += STEP * pace
            goals[index, joint] = goal
    return goals
