"""Motions for gravity: poses that tell the parameters, passed from both sides, clear of everything."""

from functools import cache

import numpy as np
import pytest

import dynid
from daq.motion.trajectory_file import parse_trajectory
from daq.robot.loader import load_robot
from drivers.core.errors import UsageError
from ident.commands.preparation.excite import PURPOSES, ExciteCommandOptions, purpose_of
from ident.model.base_parameters import gravity_base, gravity_rows, resting_model


@cache
def _designed():
    return dynid.design_gravity_motion("up6", poses=6)


def test_every_pose_is_passed_upwards_and_downwards_slowly():
    trajectory, designed = _designed()
    points = designed.motion.points
    for pose in (*designed.poses, designed.poses[0]):
        near = [index for index, point in enumerate(points) if np.allclose(abs(point - pose), designed.half_stroke)]
        begin = next(index for index in near if {index + 1, index + 2} <= set(near))
        middle = np.cumsum(designed.motion.durations + designed.motion.dwell)[begin : begin + 2]
        middle -= designed.motion.dwell + 0.5 * designed.pass_time
        position, velocity, acceleration = designed.motion.evaluate(middle)
        np.testing.assert_allclose(position.T, [pose, pose], atol=1e-9)
        np.testing.assert_allclose(velocity[:, 0], -velocity[:, 1])
        np.testing.assert_allclose(acceleration, 0.0, atol=1e-9)
        assert np.abs(velocity).max() <= 0.1 + 1e-9
    assert trajectory.duration < 300.0


def test_poses_tell_more_than_random_ones_do():
    _, designed = _designed()
    robot_file = load_robot("up6")
    model = resting_model(robot_file)
    base = gravity_base(model)

    def information(poses):
        rows = gravity_rows(model, base, poses).reshape(-1, base.count)
        return np.linalg.slogdet(rows.T @ rows)[1]

    low, high = designed.poses.min(axis=0), designed.poses.max(axis=0)
    draws = np.random.default_rng(0).uniform(low, high, (30, *designed.poses.shape))
    assert information(designed.poses) > max(information(poses) for poses in draws)
    assert designed.silent == ("S",)
    assert designed.undetermined == ()


def test_the_file_is_what_record_plays():
    trajectory, _ = _designed()
    read = parse_trajectory(trajectory.text, load_robot("up6").robot, where="", folder=None)
    time = np.linspace(0.0, trajectory.duration, 50)
    np.testing.assert_allclose(read.motion.evaluate(time)[0], trajectory.motion.evaluate(time)[0])


def test_joints_that_rest_stay_where_they_are():
    _, designed = dynid.design_gravity_motion("up6", poses=4, joints=["L"])
    assert np.all(np.ptp(designed.motion.points[:, [0, 2]], axis=0) == 0.0)
    assert np.ptp(designed.motion.points[:, 1]) > 0.5


def test_options_of_another_purpose_are_refused():
    for name, given in (("gravity", {"harmonics": 3}), ("gravity", {"kind": "points"}), ("full", {"poses": 5})):
        with pytest.raises(UsageError, match=f"does nothing with --for {name}"):
            purpose_of(ExciteCommandOptions("up6", purpose=name, **given))
    for name in PURPOSES:
        assert purpose_of(ExciteCommandOptions("up6", purpose=name)) is PURPOSES[name]
    with pytest.raises(UsageError, match="no joint of up6 is called 'Q'"):
        dynid.design_gravity_motion("up6", joints=["Q"])
