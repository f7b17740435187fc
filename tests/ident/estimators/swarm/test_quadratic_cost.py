from __future__ import annotations

import numpy as np
import pytest

from ident.estimators.swarm.minimisation import SearchBox
from ident.estimators.swarm.physical import QuadraticCost
from ident.regression.least_squares import weighted_least_squares

GENERATOR = np.random.default_rng(3)
W = GENERATOR.standard_normal((2, 400, 5)) * np.array([1.0, 10.0, 0.1, 3.0, 1.0])
TORQUE = W @ np.arange(1.0, 6.0) + GENERATOR.standard_normal((2, 400)) * np.array([[0.5], [2.0]])


def test_the_cost_on_the_factor_is_the_cost_on_all_rows(dense_reduction) -> None:
    reduction = dense_reduction(list(zip(W, TORQUE, strict=True)))
    weights = np.array([2.0, 0.5])
    cost = QuadraticCost.of_reduction(reduction, [0, 2, 4], weights)
    points = GENERATOR.standard_normal((7, 3))
    residual = weights[:, None, None] * (W[:, :, [0, 2, 4]] @ points.T - TORQUE[:, :, None])
    assert cost(points) == pytest.approx(np.sqrt(np.sum(residual**2, axis=(0, 1))), rel=1e-10)


def test_the_exact_optimum_is_weighted_least_squares_and_nothing_is_below_it(dense_reduction) -> None:
    reduction = dense_reduction(list(zip(W, TORQUE, strict=True)))
    solution = weighted_least_squares(reduction, range(5))
    cost = QuadraticCost.of_reduction(reduction, range(5), solution.weights)
    least = cost.least()
    assert least == pytest.approx(solution.parameters, rel=1e-9)
    assert cost.cost(least) == pytest.approx(solution.residual_sum**0.5)
    assert cost.cost(least) < cost(SearchBox.around(least, 0.1).draw(GENERATOR, 2000)).min()
