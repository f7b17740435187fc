"""Poses with margin to all limits."""

from __future__ import annotations

import numpy as np
import pytest
from toy_design import contradictory_problem, impossible_problem

from daq.robot.loader import load_robot
from ident.excite.choices import DesignChoices
from ident.excite.design import build_problem
from ident.excite.prior import find_prior
from ident.excite.search.poses import NoFeasiblePoseError, feasible_pose, pose_path


@pytest.fixture(scope="module")
def problem():
    ur10 = load_robot("ur10")
    return build_problem(ur10, find_prior(ur10), DesignChoices(joints=("shoulder_lift_joint", "elbow_joint")))


def test_a_pose_is_led_out_of_a_collision(problem):
    folded = np.array([-0.5, 3.1])
    joints = problem.family.joints
    assert problem.use_along(pose_path(joints, folded)).max() > 1.0
    pose = feasible_pose(problem, folded, [0])
    assert pose.use.max() <= problem.allowed
    assert pose.use == pytest.approx(problem.use_along(pose_path(joints, pose.position)))


def test_the_same_seed_gives_the_same_pose(problem):
    poses = [feasible_pose(problem, np.array([-0.5, 3.1]), [3]).position for _ in range(2)]
    assert np.array_equal(*poses)


def test_an_arm_that_begins_to_move_has_its_coulomb_friction(problem):
    joints = problem.family.joints
    path = pose_path(joints, np.zeros(2))
    assert np.all(path.velocity[joints.rows] == pytest.approx(np.array([[0.0, 1e-6, -1e-6]] * 2)))
    assert not path.velocity[[0, 3, 4, 5]].any()
    torque = next(c for c in problem.constraints if c.names[0].startswith("torque"))
    both = torque.use(path)
    still = torque.use(type(path)(path.time, path.position, 0.0 * path.velocity, path.acceleration))
    assert np.all(both[[1, 2]] > still[[1, 2]])


def test_the_limit_that_excludes_all_poses_is_named():
    with pytest.raises(NoFeasiblePoseError, match=r"300\.0 % of the distance from here, the margin allows 99 %"):
        feasible_pose(impossible_problem(), np.zeros(2), [0])


def test_limits_that_exclude_each_other_are_told_by_the_best_pose():
    """Each alone can be kept: the first joint below 0.99, and above 1.51."""
    with pytest.raises(NoFeasiblePoseError, match=r"none of .* poses tried keeps all limits at once; the best uses 1"):
        feasible_pose(contradictory_problem(), np.zeros(2), [0])
