"""Least squares under linear inequalities, against the conditions of an optimum."""

from __future__ import annotations

import numpy as np
import pytest

from ident.linear_algebra.inequalities import least_squares_within
from ident.linear_algebra.triangular import triangular


@pytest.mark.parametrize("seed", range(20))
def test_the_gradient_is_a_nonnegative_combination_of_the_active_conditions(seed):
    """Karush-Kuhn-Tucker: feasible, and every step that lowers the cost leaves the feasible cone."""
    generator = np.random.default_rng(seed)
    width, count = 6, int(generator.integers(1, 30))
    factor = triangular(generator.normal(size=(20, width)))
    target, conditions = generator.normal(size=width), generator.normal(size=(count, width))
    found = least_squares_within(factor, target, conditions)
    assert found is not None
    assert np.all(conditions @ found >= -1e-9)
    gradient = factor.T @ (factor @ found - target)
    assert gradient @ found == pytest.approx(0.0, abs=1e-8)  # the cone's point nearest to what was aimed at
    for _ in range(200):  # no point of the cone is better
        other = least_squares_within(np.eye(width), generator.normal(size=width), conditions)
        assert other is not None
        assert gradient @ other >= -1e-8


def test_without_conditions_it_is_least_squares():
    generator = np.random.default_rng(1)
    factor, target = triangular(generator.normal(size=(9, 4))), generator.normal(size=4)
    found = least_squares_within(factor, target, np.empty((0, 4)))
    assert np.allclose(factor @ found, target)


def test_conditions_that_hold_change_nothing():
    factor, target = np.diag([1.0, 2.0]), np.array([1.0, 2.0])
    assert np.allclose(least_squares_within(factor, target, np.eye(2)), [1.0, 1.0])
    assert np.allclose(least_squares_within(factor, target, np.array([[-1.0, 0.0]])), [0.0, 1.0])
