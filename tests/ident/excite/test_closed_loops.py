"""Excitations of arms with general closed loops: designed like any other, where the loops close."""

from __future__ import annotations

import numpy as np
import pytest
from loop_arms import four_bar_arm

from daq.motion.limits import check_limits, check_rest
from ident.excite.choices import DesignChoices
from ident.excite.constraints.constraints import criterion_within_limits
from ident.excite.criteria import RegressorCriterion, condition
from ident.excite.design import build_problem, design
from ident.excite.path import JointPath
from ident.excite.prior import find_prior
from ident.excite.search.search import SearchChoices
from ident.model.dynamic_model import build_model


@pytest.fixture(scope="module")
def problem():
    robot_file = four_bar_arm()
    return build_problem(robot_file, find_prior(robot_file), DesignChoices(harmonics=3, criterion="condition"))


def test_the_derivatives_of_cost_and_limits_are_those_of_finite_differences(problem) -> None:
    generator = np.random.default_rng(0)
    x = problem.family.random(generator)
    _, gradient = problem.smooth_cost(x, 8.0)
    bounds, rows = problem.smooth_use(x, 30.0)
    for _ in range(3):
        direction = generator.standard_normal(x.size)
        ends = [x + step * direction for step in (-2e-5, 2e-5)]
        costs = [problem.smooth_cost(end, 8.0)[0] for end in ends]
        # The least eigenvalue, 1e-8 of the largest, is known to 1e-8 of itself.
        assert abs((costs[1] - costs[0]) / 4e-5 - gradient @ direction) < 2e-3 * np.linalg.norm(gradient)
        uses = [problem.smooth_use(end, 30.0)[0] for end in ends]
        np.testing.assert_allclose((uses[1] - uses[0]) / 4e-5, rows @ direction, atol=1e-5 * np.abs(bounds).max())


def test_motions_far_outside_of_the_limits_can_be_looked_at(problem) -> None:
    """There the loop does not close; solvers try such motions on their way."""
    far = 30.0 * problem.family.random(np.random.default_rng(1))
    cost, gradient = problem.smooth_cost(far, 8.0)
    assert np.isfinite(cost)
    assert np.all(np.isfinite(gradient))
    assert problem.use(far).max() > 1.0


def test_within_the_limits_nothing_is_changed() -> None:
    model = build_model(four_bar_arm())
    plain = RegressorCriterion(model, range(10, 20), condition)
    moved = criterion_within_limits(model, plain)
    assert moved is not plain
    low, high = (np.array(limit)[:, None] for limit in zip(*(joint.position for joint in model.limits), strict=True))
    position = np.random.default_rng(2).uniform(low, high, (3, 40))
    path = JointPath(np.arange(40.0), position, *np.random.default_rng(3).standard_normal((2, 3, 40)))
    assert moved.cost(path) == plain.cost(path)
    one, other = moved.smooth_cost(path, 8.0), plain.smooth_cost(path, 8.0)
    assert one[0] == other[0]
    np.testing.assert_array_equal(one[1], other[1])


def test_a_whole_design_keeps_every_limit() -> None:
    robot_file = four_bar_arm()
    search = SearchChoices(seed=1, starts=1, workers=1)
    found = design(robot_file, find_prior(robot_file), DesignChoices(harmonics=1, period=3.0, ramp=1.0), search)
    assert found.use.max() <= 1.0
    check_limits(found.motion, robot_file.robot.joints, "design")
    check_rest(found.motion, robot_file.robot.joints, "design")
