"""A motion for friction: one joint at a time, within limits and clear of everything."""

from __future__ import annotations

import numpy as np
import pytest
from each import each

from daq.robot.loader import load_robot
from drivers.core.errors import MotionRefusedError, UsageError
from ident.excite.choices import SweepChoices
from ident.excite.motion_check import ArmMotionCheck
from ident.excite.velocity_sweep import velocity_sweep


@pytest.fixture(scope="module")
def sweep():
    robot_file = load_robot("ur5e")
    joints = ("shoulder_lift_joint", "wrist_3_joint")
    choices = SweepChoices(joints=joints, speeds=3, slowest=0.4)
    return robot_file, velocity_sweep(robot_file, ArmMotionCheck(robot_file), choices)


def test_one_joint_moves_at_a_time_and_both_return(sweep):
    robot_file, designed = sweep
    moving = np.diff(designed.motion.points, axis=0) != 0.0
    assert np.all(moving.sum(axis=1) == 1)
    assert set(np.flatnonzero(moving.any(axis=0))) == {1, 5}
    np.testing.assert_array_equal(designed.motion.points[0], designed.motion.points[-1])
    np.testing.assert_array_equal(designed.motion.points[0], robot_file.robot.poses["home"])


def test_speeds_rise_and_fall_and_forth_is_as_fast_as_back(sweep):
    _, designed = sweep
    for joint in designed.joints:
        assert list(joint.speeds) == sorted(joint.speeds)
    first = designed.motion.durations[1:13]
    np.testing.assert_allclose(first[::2], first[1::2])
    np.testing.assert_allclose(first, first[::-1])
    assert first[0] > 2 * first[5]


def test_limits_hold_everywhere(sweep):
    robot_file, designed = sweep
    time = np.linspace(0.0, designed.motion.duration, 50_001)
    position, velocity, acceleration = designed.motion.evaluate(time)
    for row, limits in enumerate(robot_file.robot.joints):
        assert limits.position[0] < position[row].min()
        assert position[row].max() < limits.position[1]
        assert np.abs(velocity[row]).max() <= 0.9 * limits.velocity * (1 + 1e-9)
        assert np.abs(acceleration[row]).max() <= 0.9 * limits.acceleration * (1 + 1e-9)
    peaks = [np.abs(velocity[row]).max() for row in (1, 5)]
    np.testing.assert_allclose(peaks, [joint.speeds[-1] for joint in designed.joints], rtol=1e-4)


class _Refusing(ArmMotionCheck):
    """Lets joint 1 move by less than half a radian."""

    def __init__(self) -> None:
        pass

    def trajectory(self, motion, where):
        if np.ptp(motion.points[:, 0]) > 0.5 or np.ptp(motion.points[:, 1]) > 0.0:
            raise MotionRefusedError("too near", where=where)


def test_a_stroke_that_is_not_free_is_halved_and_a_joint_that_cannot_move_says_why():
    robot_file = load_robot("ur5e")
    choices = SweepChoices(joints=("shoulder_pan_joint", "shoulder_lift_joint"))
    free, caught = velocity_sweep(robot_file, _Refusing(), choices).joints
    assert free.high - free.low == pytest.approx(0.3)
    assert (caught.speeds, caught.refusal) == ((), "too near")
    with pytest.raises(MotionRefusedError, match=r"no joint can move from this pose: too near"):
        velocity_sweep(robot_file, _Refusing(), SweepChoices(joints=("shoulder_lift_joint",)))


@each(
    ("options", "message"),
    [
        ({"joints": ("elbow",)}, "no joint of ur5e is called 'elbow'"),
        ({"pose": "candle"}, "no pose is called 'candle'"),
        ({"stroke": float("nan")}, "--stroke"),
        ({"slowest": 0.0}, "--slowest"),
        ({"speeds": 1}, "--speeds"),
    ],
)
def test_bad_choices_are_refused_in_one_line(options, message):
    robot_file = load_robot("ur5e")
    with pytest.raises(UsageError, match=message) as refused:
        velocity_sweep(robot_file, _Refusing(), SweepChoices(**options))
    assert "\n" not in str(refused.value)
