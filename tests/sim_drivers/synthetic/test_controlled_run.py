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
