"""A motor's limit cuts the sum of its spring, its damper and its own torque, and what is cut is what it measures."""

from __future__ import annotations

import numpy as np
import pytest
from motor_bench import START, keys_of, robot_file

from drivers.can_motors.settings import parse_settings
from sim_drivers.can_motors.arm import Command, MotorPlant

GAINS = (60.0, 2.0)
STEP = 0.001
"""[s] between two looks."""


def plant() -> MotorPlant:
    settings = parse_settings(keys_of("damiao"), robot_file().robot.joint_names, "damiao")
    return MotorPlant(robot_file(), settings.motors, START, 0.0)


def follow(arm: MotorPlant, speed: float, seconds: float, limit: float | None = None) -> tuple[np.ndarray, np.ndarray]:
    """The first joint follows goals that move on evenly: its spring [N·m] and its torque (N,) after each of them."""
    springs, torques = [], []
    arm.limit(0, limit)
    for index in (0, 1):
        arm.command(index, 0.0, Command(arm._motors[index].goal(START[index])), GAINS)
    for step in range(round(seconds / STEP)):
        now = (step + 1) * STEP
        goal = START[0] + speed * now
        arm.command(0, now, Command(goal), GAINS)
        arm.advance(now + 0.9 * STEP)
        said = arm.measured(0)
        springs.append(GAINS[0] * (goal - said["position"]))
        torques.append(said["torque"])
    return np.array(springs), np.array(torques)


def test_a_fast_joints_damper_takes_no_share_of_the_limit() -> None:
    arm = plant()
    springs, torques = follow(arm, 5.8, 0.3)
    assert springs.max() > 11.0  # of 10 N·m, which the damper to rest takes away again
    assert np.abs(torques).max() < 10.0
    assert arm.arm.velocity[0] == pytest.approx(5.8, rel=0.1)


def test_the_limit_cuts_the_sum() -> None:
    arm = plant()
    springs, torques = follow(arm, 3.0, 0.3, limit=1.5)
    assert np.abs(torques).max() == 1.5
    assert (np.abs(torques) == 1.5).mean() > 0.3
    assert springs.max() > 3.0
    still = plant()
    assert still.measured(0)["torque"] == 0.0
    still.command(0, 0.0, Command(START[0], torque=20.0), (0.0, 0.0))
    still.advance(0.01)
    assert still.measured(0)["torque"] == 10.0
    still.let_go(0)
    assert still.measured(0)["torque"] == 0.0
