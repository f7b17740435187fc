"""Least squares under linear inequalities, against the conditions of an optimum."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import nnls

from ident.linear_algebra.inequalities import least_squares_within, nonnegative_least_squares
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


def test_nonnegative_least_squares_is_scipys():
    """Also with repeated columns and with columns whose lengths differ by eleven orders of magnitude."""
    generator = np.random.default_rng(2)
    for trial in range(150):
        rows, width = generator.integers(1, 30, 2)
        matrix, target = generator.normal(size=(rows, width)), generator.normal(size=rows)
        if trial % 3 == 0:
            matrix[:, width // 2] = matrix[:, 0]
        if trial % 5 == 0:
            matrix = matrix * 10.0 ** generator.integers(-5, 6, width)
        found = nonnegative_least_squares(matrix, target)
        assert found is not None
        assert np.all(found >= 0.0)
        assert np.linalg.norm(matrix @ found - target) == pytest.approx(nnls(matrix, target)[1], rel=1e-9, abs=1e-9)
