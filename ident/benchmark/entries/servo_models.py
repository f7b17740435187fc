"""Servo arms: dynid's servo model, and what it has to be better than."""

from __future__ import annotations

import numpy as np

from daq.recording.commanded_motion import TARGET, CommandedMotion
from drivers.core.arrays import FloatArray
from ident.benchmark.entry import ServoPredictor, Training
from ident.benchmark.motion import values_at
from ident.servo.arm_rollout import delay_and_lag as searched
from ident.servo.arm_rollout import delayed_paths
from ident.servo.identify import read_motions
from ident.servo.motion import servo_motions
from ident.tasks.servo import ServoModel, identify_servo


def dynid_servo(training: Training) -> ServoPredictor:
    """Return what `dynid identify --method servo` identifies."""
    model: ServoModel = identify_servo(list(training.recordings), validation=list(training.recordings[:1]))

    def roll_out(time: FloatArray, command: FloatArray, start: FloatArray) -> FloatArray:
        played = model.simulate(time, command, start=start)
        return values_at(time, played.time, played.position)

    return ServoPredictor(roll_out)


def delay_and_lag(training: Training) -> ServoPredictor:
    """One delay and one first-order lag for all joints."""
    motions = [motion for recording in training.recordings for motion in read_motions(recording, training.robot)]
    delay, lag = searched(motions)

    def roll_out(time: FloatArray, command: FloatArray, start: FloatArray) -> FloatArray:
        positions = np.tile(start, (len(time), 1))
        given = CommandedMotion(training.robot.robot.joint_names, time, positions, time, {TARGET: command})
        played = servo_motions(given, "commands")
        stamps = np.concatenate([motion.begin + motion.time for motion in played])
        return values_at(time, stamps, np.concatenate(delayed_paths(played, delay, lag)))

    return ServoPredictor(roll_out)


def command_itself(training: Training) -> ServoPredictor:
    """The arm is where it was commanded to be."""
    return ServoPredictor(lambda time, command, start: command)


for _method in (dynid_servo, delay_and_lag, command_itself):
    _method.kind = "servo"  # type: ignore[attr-defined]
