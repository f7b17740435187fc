"""Arms whose recordings are shorter: fewer samples of the same motion."""

from __future__ import annotations

from daq.robot.loader import RobotFile


def sampled(robot_file: RobotFile, rate: float) -> RobotFile:
    """The arm, recorded at `rate` [Hz] by its simulation."""
    robot = robot_file.robot
    noise = robot.truth.noise.model_copy(update={"rate": rate})
    truth = robot.truth.model_copy(update={"noise": noise})
    return robot_file.model_copy(update={"robot": robot.model_copy(update={"truth": truth})})
