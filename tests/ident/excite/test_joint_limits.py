"""Joint limits as constraints: what is used, the smooth bound, its derivatives."""

from __future__ import annotations

import numpy as np
import pytest
from path_derivatives import assert_derivatives, assert_upper_bound, random_path

from daq.robot.schema import JointLimits
from ident.excite.constraints.torque_limits import JointMotionLimits
from ident.excite.path import JointPath

LIMITS = (
    JointLimits(name="a", position=(-1.0, 3.0), velocity=2.0, acceleration=5.0),
    JointLimits(name="b", position=(0.0, 0.5), velocity=0.25, acceleration=1.0),
)


def still(position):
    position = np.array(position, dtype=float)[:, None]
    return JointPath(np.zeros(1), position, np.zeros_like(position), np.zeros_like(position))


def by_name(constraint, path):
    return dict(zip(constraint.names, constraint.use(path), strict=True))


def test_all_of_a_limit_is_one():
    constraint = JointMotionLimits(LIMITS)
    at_upper, at_middle = by_name(constraint, still([3.0, 0.25])), by_name(constraint, still([1.0, 0.0]))
    assert at_upper["upper position limit of a"] == pytest.approx(1.0)
    assert at_upper["lower position limit of a"] == pytest.approx(-1.0)
    assert at_upper["upper position limit of b"] == pytest.approx(0.0)
    assert at_middle["upper position limit of a"] == pytest.approx(0.0)
    assert at_middle["lower position limit of b"] == pytest.approx(1.0)
    moving = JointPath(
        np.zeros(2), np.zeros((2, 2)), np.array([[1.0, -2.0], [0.0, 0.1]]), np.array([[0, 0], [-0.5, 0.2]])
    )
    used = by_name(constraint, moving)
    assert used["velocity of a"] == pytest.approx(1.0)
    assert used["velocity of b"] == pytest.approx(0.4)
    assert used["acceleration of b"] == pytest.approx(0.5)


def test_infinite_limits_do_not_count():
    # A robot file has finite limits only; a caller's own may not be.
    free = JointLimits.model_construct(
        name="c", position=(-np.inf, np.inf), velocity=np.inf, acceleration=3.0, torque=None, temperature=None
    )
    assert JointMotionLimits([free]).names == ("acceleration of c",)


@pytest.mark.parametrize("sharpness", [3.0, 40.0])
def test_derivatives_and_bound(random_tree, sharpness):
    model = random_tree(2, dof=4)
    constraint = JointMotionLimits(model.limits)
    path = random_path(model, 5)
    assert_derivatives(constraint, path, sharpness)
    assert_upper_bound(constraint, path)


def test_a_joint_at_rest_has_no_direction(random_tree):
    model = random_tree(2, dof=2)
    constraint = JointMotionLimits(model.limits)
    path = JointPath(np.zeros(3), *np.zeros((3, 2, 3)))
    bound, gradient = constraint.smooth_use(path, 20.0)
    assert np.all(np.isfinite(bound))
    assert np.all(gradient[:, 1:] == 0.0)
