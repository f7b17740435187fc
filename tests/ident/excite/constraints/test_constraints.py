"""Which constraints an arm's file asks for."""

from __future__ import annotations

import numpy as np
import pytest

from daq.robot.loader import load_robot, parse_robot
from drivers.core.errors import UsageError
from ident.excite.constraints.constraints import constraints_of
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.true_parameters import truth_vector

ONE_JOINT = """
name: one
model: {mdh: [{joint: a, alpha: 0, d: 0, r: 0.2}]}
joints: [{name: a, position: [-1, 1], velocity: 1}]
"""


def kinds(constraints):
    return [type(constraint).__name__ for constraint in constraints]


def test_what_the_file_has_decides():
    robot_file = load_robot("ur10")
    model = build_model(robot_file)
    base = base_parameters(model)
    prior = base.projection @ truth_vector(robot_file)
    assert kinds(constraints_of(robot_file, model, None, False)) == ["JointMotionLimits", "WorkspaceLimits"]
    assert kinds(constraints_of(robot_file, model, prior, True)) == [
        "JointMotionLimits",
        "TorqueLimits",
        "WorkspaceLimits",
        "SelfCollision",
    ]
    free = parse_robot(robot_file.text.replace("mounting: table", "mounting: free"), where="free", folder=None)
    assert kinds(constraints_of(free, model, None, False)) == ["JointMotionLimits"]


def test_an_arm_without_torque_limits_and_pairs_has_its_joints_only():
    robot_file = parse_robot(ONE_JOINT, where="one", folder=None)
    model = build_model(robot_file)
    prior = np.ones(base_parameters(model).count)
    assert kinds(constraints_of(robot_file, model, prior, True)) == ["JointMotionLimits"]


@pytest.mark.parametrize("wrong", [np.ones(3), np.full(54, np.nan)])
def test_parameters_that_are_not_the_arms_are_refused(wrong):
    robot_file = load_robot("ur10")
    with pytest.raises(UsageError, match="finite base parameters") as caught:
        constraints_of(robot_file, build_model(robot_file), wrong, False)
    assert caught.value.exit_status == 2
