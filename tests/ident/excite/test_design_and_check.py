"""A design and the check before a motion is played keep the same: what `excite` writes, `record` does not refuse."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_arms import random_arm

from daq.motion.trajectories import PointToPoint
from daq.motion.trajectory_file import dump_trajectory, parse_trajectory
from daq.robot.loader import changed_since, fingerprint, parse_robot
from drivers.core.errors import UsageError
from ident.excite.choices import DesignChoices
from ident.excite.constraints.self_collision import SelfCollision
from ident.excite.design import build_problem
from ident.excite.motion_check import ArmMotionCheck
from ident.excite.prior import find_prior
from ident.excite.search.acceptance import accepted, shrunk_to_fit
from ident.excite.search.poses import feasible_pose

CHOICES = DesignChoices(harmonics=1, period=4.0, periods=1)


@pytest.mark.parametrize("seed", [2, 6])
def test_what_a_design_accepts_the_check_of_a_motion_accepts(seed: int) -> None:
    robot_file = random_arm(seed, joints=3)
    problem = build_problem(robot_file, find_prior(robot_file), CHOICES)
    check = ArmMotionCheck(robot_file)
    designed = [one.pairs for one in problem.constraints if isinstance(one, SelfCollision)]
    assert designed == [one.pairs for one in check._pairs]
    begin = problem.family.random(np.random.default_rng(seed))
    pose = feasible_pose(problem, problem.family.middle(begin), (0,), lambda: None).position
    variables = shrunk_to_fit(problem, begin, pose)
    assert variables is not None
    found = accepted(problem, variables)
    assert found is not None
    assert check.refusal(found.motion) == ""
    stricter = replace(problem, refusal=lambda _: "link lift enters link base")
    assert accepted(stricter, variables, final=True) is None
    assert accepted(replace(stricter, by_hull=True), variables) is None


def test_a_robot_file_that_changed_since_the_design_is_named() -> None:
    text = """
name: lift
model: {mdh: [{joint: j1, antecedent: base, alpha: 0, d: 0, r: 0.3}]}
joints: [{name: j1, position: [-3, 3], velocity: 2, acceleration: 9}]
"""
    robot = parse_robot(text, where="lift", folder=None).robot
    slower = parse_robot(text.replace("velocity: 2", "velocity: 0.1"), where="lift", folder=None).robot
    designed_for = fingerprint(robot, "<robot/>")
    assert changed_since(designed_for, robot, "<robot/>") == changed_since({}, slower) == ""
    assert changed_since(designed_for, slower, "<robot></robot>").endswith("designed: joints, urdf")
    motion = PointToPoint(np.array([[0.0], [1.0]]), np.array([2.0]))
    written = {"robot": "lift", "kind": "points", "points": motion.points.tolist(), "durations": [2.0]}
    read = parse_trajectory(str({**written, "designed_for": designed_for}), robot, where="t.yaml", folder=None)
    again = dump_trajectory(read.trajectory)
    with pytest.raises(UsageError, match="passes its limit") as refused:
        parse_trajectory(again, slower, where="t.yaml", folder=None)
    assert refused.value.hint == "the robot file changed since the motion was designed: joints"
