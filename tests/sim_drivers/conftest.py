"""Simulated arms that several tests change."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from daq.robot.loader import RobotFile, parse_robot

PENDULUM = """
name: pendulum
model:
  mdh:
    - {{joint: swing, alpha: pi/2, d: 0, r: 0}}
joints:
  - {{name: swing, position: [-20, 20], velocity: 5, acceleration: 20, torque: 60}}
drives:
  - {{joint: swing, gain: {gain}, signal: current}}
truth:
  links:
    swing: {{mass: 2, com: [0.25, 0, 0], inertia: [0.001, 0, 0, 0.01, 0, 0.01]}}
  joints:
    swing: {{motor_inertia: 0.3, {friction}}}
  thermal: {{{thermal}}}
  noise: {{rate: 500, {noise}}}
"""


@pytest.fixture(scope="session")
def pendulum() -> Callable[..., RobotFile]:
    """Makes a link of 2 kg on one joint; horizontal at 0, where gravity pulls with 4.9 N·m."""

    def make(friction: str = "", noise: str = "", thermal: str = "", gain: float = 10.0) -> RobotFile:
        text = PENDULUM.format(friction=friction, noise=noise, thermal=thermal, gain=gain)
        return parse_robot(text, where="pendulum", folder=None)

    return make


@pytest.fixture(scope="session")
def with_truth() -> Callable[..., RobotFile]:
    """Copies a robot file with parts of its truth replaced."""

    def change(robot_file: RobotFile, **parts: Any) -> RobotFile:
        truth = robot_file.robot.truth.model_copy(update=parts)
        return robot_file.model_copy(update={"robot": robot_file.robot.model_copy(update={"truth": truth})})

    return change
