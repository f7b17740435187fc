"""A plant that is recorded: it follows, warms up, and keeps its heat."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from daq.motion.trajectories import PointToPoint
from daq.robot.loader import load_robot, parse_robot
from sim_drivers.plant.plant import Plant
from studies.synthetic.controlled_run import record_plant


def test_the_plant_follows_and_is_warmer_the_second_time():
    robot_file = load_robot("up6")
    points = np.array([[0.0, 0.3, 0.0], [0.5, 0.8, 0.4], [0.0, 0.3, 0.0]])
    motion = PointToPoint(points, np.array([1.5, 1.5]))
    plant = Plant(robot_file, seed=1, position=points[0])
    first, second = (record_plant(robot_file, plant, motion, 100.0).streams["joints"] for _ in range(2))
    followed = motion.evaluate(np.arange(300) / 100.0 + 0.01)[0].T
    np.testing.assert_allclose(first.channels["position"].values, followed, atol=0.02)
    assert np.all(np.diff(np.concatenate([first.time, second.time])) > 0.0)
    warm = [np.mean(stream.channels["temperature"].values) for stream in (first, second)]
    assert warm[1] > warm[0]


@pytest.mark.parametrize("rate", [100.0, 200.0])
def test_a_slow_recording_sees_the_same_torque(rate: float):
    # 100 Hz is a fifth of the control rate; samples at 200 Hz come at the end and in the middle of control periods.
    robot_file = load_robot("aubo_i5")
    robot = yaml.safe_load(robot_file.text)
    robot["truth"]["noise"], robot["model"]["gravity"] = {"rate": 500}, [0.0, 0.0, 0.0]
    robot_file = parse_robot(yaml.safe_dump(robot), where="aubo_i5", folder=None)
    motion = PointToPoint(np.array([np.zeros(6), np.full(6, 0.5)]), np.array([1.5]))
    # From 0.5 to 1 s all joints move steadily.
    means = [
        np.mean(
            record_plant(robot_file, Plant(robot_file, seed=1, position=np.zeros(6)), motion, frequency)
            .streams["joints"]
            .channels["current"]
            .values[round(0.5 * frequency) : round(frequency)],
            axis=0,
        )
        for frequency in (500.0, rate)
    ]
    gains = np.array([robot_file.robot.drive(name).gain for name in robot_file.robot.joint_names])
    coulomb = np.array([joint.coulomb for joint in robot_file.robot.truth.joints.values()])
    assert np.all(np.abs(means[1] - means[0]) * gains < 0.02 * coulomb), means


@pytest.mark.parametrize("rate", [60.0, 125.0, 400.0, 1000.0])
def test_samples_come_at_the_rate_and_end_with_the_motion(rate: float):
    robot_file = load_robot("up6")
    motion = PointToPoint(np.array([np.zeros(3), np.full(3, 0.05)]), np.array([0.5]))
    run = record_plant(robot_file, Plant(robot_file, seed=1, position=np.zeros(3)), motion, rate).streams["joints"]
    np.testing.assert_allclose(run.time, (np.arange(round(0.5 * rate)) + 1.0) / rate, atol=0.51e-3)
