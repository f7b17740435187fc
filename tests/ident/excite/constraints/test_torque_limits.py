"""Torque limits as constraints: same torque as the regressor's, and its derivatives."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from path_derivatives import assert_derivatives, assert_upper_bound, random_path
from pinocchio_reference import pinocchio_regressor

from daq.robot.schema import JointLimits
from ident.excite.constraints import torque_limits
from ident.excite.constraints.torque_limits import JointMotionLimits, TorqueLimits
from ident.excite.path import JointPath
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.true_parameters import truth_vector


def with_torque(model, limits):
    changed = tuple(
        JointLimits(name=old.name, position=old.position, velocity=old.velocity, torque=torque)
        for old, torque in zip(model.limits, limits, strict=True)
    )
    return dataclasses.replace(model, limits=changed)


@pytest.mark.parametrize("seed", range(6))
def test_derivatives_and_bound_on_random_trees(random_tree, seed):
    model = random_tree(seed, dof=2 + seed % 4)
    model = with_torque(model, [50.0, None, 80.0, 20.0, 10.0][: model.dof])
    count = len(model.parameters)
    columns = sorted(np.random.default_rng(seed).choice(count, size=count // 2, replace=False).tolist())
    constraint = TorqueLimits(model, columns, np.random.default_rng(seed).standard_normal(len(columns)))
    assert [n.split()[2] for n in constraint.names] == [j.name for j in model.limits if j.torque is not None]
    path = random_path(model, seed)
    assert_derivatives(constraint, path, 3.0)
    assert_derivatives(constraint, path, 60.0)
    assert_upper_bound(constraint, path)


def test_base_parameters_need_the_torque_of_the_standard_ones(three_joint):
    model = build_model(three_joint)
    truth = truth_vector(three_joint)
    base = base_parameters(model)
    constraint = TorqueLimits(model, base.columns, base.projection @ truth)
    path = random_path(model, 4, count=30)
    motion = (path.position, path.velocity, path.acceleration)
    torque = np.einsum("npt,p->nt", pinocchio_regressor(model, *motion), truth)
    limits = torque_limits.TORQUE_SHARE * np.array([100.0, 100.0, 50.0])
    assert np.allclose(constraint.use(path), np.abs(torque).max(axis=1) / limits, rtol=1e-9)


def test_the_derivative_does_not_depend_on_the_chunk(three_joint, monkeypatch):
    model = build_model(three_joint)
    base = base_parameters(model)
    path = random_path(model, 4, count=30)
    whole = TorqueLimits(model, base.columns, base.projection @ truth_vector(three_joint)).smooth_use(path, 5.0)
    monkeypatch.setattr(torque_limits, "SAMPLES_AT_ONCE", 7)
    parts = TorqueLimits(model, base.columns, base.projection @ truth_vector(three_joint)).smooth_use(path, 5.0)
    assert np.array_equal(whole[0], parts[0])
    assert np.allclose(whole[1], parts[1], rtol=0, atol=1e-14)


@pytest.mark.parametrize("parameters", [np.zeros(3), np.array([np.nan, 0.0])])
def test_one_finite_parameter_a_column(three_joint, parameters):
    with pytest.raises(ValueError, match="2 columns need as many finite parameters"):
        TorqueLimits(build_model(three_joint), [0, 1], parameters)


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
