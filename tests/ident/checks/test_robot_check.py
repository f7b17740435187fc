"""What `dynid check` finds in a robot file."""

from __future__ import annotations

import pytest
from each import each

from daq.robot.loader import builtin_robots, load_robot, parse_robot
from drivers.core.errors import RobotFileError
from ident.checks.robot_check import check_robot


def changed(robot_file, old: str, new: str):
    assert old in robot_file.text
    return parse_robot(robot_file.text.replace(old, new), where="changed", folder=None)


def test_a_complete_file_has_no_warnings(three_joint):
    found = check_robot(three_joint)
    assert (found.problems, found.warnings) == ((), ())


@pytest.mark.parametrize("name", builtin_robots())
def test_built_in_robots_can_be_identified(name):
    assert not any("gravity" in warning for warning in check_robot(load_robot(name)).warnings)


@each(
    ("old", "new", "expected"),
    [
        ("  - {joint: j2, gain: -8, gain_std: 0.5}\n", "", "gain of j2 is unknown"),
        ("gain: 4, gain_std: 0.2", "gain: 4", "gain of j3 has no standard deviation"),
        ("model:\n", "model:\n  gravity: [0, 0, -1.62]\n", "gravity is 1.62"),
        ("model:\n", "model:\n  gravity: [0, 0, 0]\n", "gravity is 0"),
        ("acceleration: 10, torque: 50", "acceleration: 10", "no torque limit for j3"),
        ("truth:\n", "connections:\n  main: {driver: telepathy}\ntruth:\n", "needs the driver 'telepathy'"),
    ],
)
def test_what_is_missing_is_named(three_joint, old, new, expected):
    (warning,) = check_robot(changed(three_joint, old, new)).warnings
    assert expected in warning


def test_tilted_gravity_is_still_earths(three_joint):
    assert check_robot(changed(three_joint, "model:\n", "model:\n  gravity: [6.94, 0, -6.94]\n")).warnings == ()


def test_a_torque_sensor_needs_no_gain(three_joint):
    sensed = changed(three_joint, "{joint: j2, gain: -8, gain_std: 0.5}", "{joint: j2, signal: torque}")
    assert check_robot(sensed).warnings == ()


def test_a_urdf_without_the_joints_is_refused(three_joint):
    text = three_joint.text[three_joint.text.index("joints:") :]
    text = "name: urdf\nmodel: {urdf: arm.urdf}\n" + text
    urdf = '<robot name="arm"><link name="only"/></robot>'
    (problem,) = check_robot(parse_robot(text, where="arm.yaml", folder=None, urdf_text=urdf)).problems
    assert isinstance(problem, RobotFileError)
    assert problem.where.startswith("arm.yaml: arm.urdf")
