"""A plant that is recorded: it follows, warms up, and keeps its heat."""

from __future__ import annotations

import numpy as np

from daq.motion.trajectories import PointToPoint
from daq.robot.loader import load_robot
from sim_drivers.plant.plant import Plant
from sim_drivers.synthetic.controlled_run import record_plant


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


def test_a_slow_recording_sees_the_same_torque():
    robot_file = load_robot("aubo_i5")
    motion = PointToPoint(np.array([np.zeros(6), np.full(6, 0.5)]), np.array([1.5]))
    fast, slow = (
        record_plant(robot_file, Plant(robot_file, seed=1, position=np.zeros(6)), motion, rate)
        for rate in (500.0, 100.0)
    )
    # From 0.5 to 1 s all joints move steadily; noise and ripple average out to below 0.1 of the friction.
    means = [
        np.mean(run.streams["joints"].channels["current"].values[round(0.5 * rate) : round(rate)], axis=0)
        for run, rate in ((fast, 500.0), (slow, 100.0))
    ]
    gains = np.array([robot_file.robot.drive(name).gain for name in robot_file.robot.joint_names])
    coulomb = np.array([joint.coulomb for joint in robot_file.robot.truth.joints.values()])
    assert np.all(np.abs(means[1] - means[0]) * gains < 0.1 * coulomb), means
