"""Point-to-point motions for simulated arms: within the limits, and as fast as they allow."""

from __future__ import annotations

import numpy as np
import pytest
from each import each

from daq.motion.limits import check_limits, check_rest, motion_extremes
from daq.robot.loader import builtin_robots, load_robot
from studies.synthetic.random_points import LIMIT_SHARE, random_points_motion


@each("name", builtin_robots())
def test_limits_are_kept_and_used(name):
    robot = load_robot(name).robot
    motion = random_points_motion(robot, seed=1, moves=12)
    check_limits(motion, robot.joints, where=name)
    check_rest(motion, robot.joints, where=name)
    found = motion_extremes(motion)
    use = [
        np.abs(found.velocity) / [joint.velocity for joint in robot.joints],
        np.abs(found.acceleration) / [joint.acceleration for joint in robot.joints],
    ]
    assert np.max(use) == pytest.approx(LIMIT_SHARE, rel=1e-6)


def test_the_others_stand_still():
    robot = load_robot("sr400").robot
    motion = random_points_motion(robot, seed=2, moves=5, moving=("j5", "j6"))
    position, velocity, _ = motion.evaluate(np.linspace(0.0, motion.duration, 500))
    moves = np.any(velocity != 0.0, axis=1)
    assert [name for name, each in zip(robot.joint_names, moves, strict=True) if each] == ["j5", "j6"]
    assert position[1, 0] == pytest.approx(np.mean(robot.joints[1].position))


def test_seeds_differ_and_repeat():
    robot = load_robot("ur5e").robot
    first, again, other = (random_points_motion(robot, seed, 3).points for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
