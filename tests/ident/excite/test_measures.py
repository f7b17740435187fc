"""Measures of an information matrix: their definitions, their derivatives, their bounds."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from ident.excite.criteria import (
    condition,
    d_optimal,
    deviations,
    e_optimal,
    moments_apart,
    plain_condition,
)

SIZE = 8
SCALE = np.exp(np.random.default_rng(5).standard_normal(SIZE))
MEASURES = {
    "plain_condition": plain_condition,
    "condition": condition,
    "d_optimal": d_optimal,
    "e_optimal": e_optimal,
    "deviations": deviations(SCALE),
    "moments_apart": moments_apart((0, 1, 2), (3, 4, 5, 6), (1.0, 2.0)),
}


def regressor(seed: int) -> np.ndarray:
    generator = np.random.default_rng(seed)
    return generator.standard_normal((40, SIZE)) * np.exp(generator.standard_normal(SIZE))


def unit(matrix: np.ndarray) -> np.ndarray:
    return matrix / np.linalg.norm(matrix, axis=0)


@pytest.mark.parametrize("sharpness", [1.0, 4.0, 64.0, np.inf])
@pytest.mark.parametrize("name", MEASURES)
def test_derivative_equals_finite_differences(name, sharpness):
    for seed in range(4):
        gram = regressor(seed).T @ regressor(seed)
        direction = np.random.default_rng(seed + 50).standard_normal((SIZE, SIZE))
        direction += direction.T
        _, gradient = MEASURES[name](gram, sharpness)
        step = 1e-6 * np.linalg.eigvalsh(gram)[0]
        ahead, behind = (MEASURES[name](gram + sign * step * direction, sharpness)[0] for sign in (1.0, -1.0))
        slope = (ahead - behind) / (2 * step)
        assert np.sum(gradient * direction) == pytest.approx(slope, rel=1e-5, abs=1e-7), seed
        assert np.allclose(gradient, gradient.T), seed


@pytest.mark.parametrize("seed", range(4))
def test_exact_values_are_what_they_say(seed):
    phi = regressor(seed)
    gram = phi.T @ phi
    exact = {name: measure(gram, np.inf)[0] for name, measure in MEASURES.items()}
    inverse = np.linalg.inv(gram)
    assert exact["plain_condition"] == pytest.approx(np.log(np.linalg.cond(phi)))
    assert exact["condition"] == pytest.approx(np.log(np.linalg.cond(unit(phi))))
    assert exact["d_optimal"] == pytest.approx(-np.linalg.slogdet(gram)[1] / SIZE)
    assert exact["e_optimal"] == pytest.approx(-np.log(np.linalg.svd(phi)[1][-1] ** 2))
    assert exact["deviations"] == pytest.approx(0.5 * np.log(np.mean(np.diag(inverse) / SCALE**2)))
    apart = np.linalg.cond(unit(phi[:, :3])) + 2.0 * np.linalg.cond(unit(phi[:, 3:7]))
    assert exact["moments_apart"] == pytest.approx(np.log(apart))


@pytest.mark.parametrize("name", ["plain_condition", "condition", "e_optimal", "moments_apart"])
def test_smooth_values_bound_the_exact_one_and_tend_to_it(name):
    gram = regressor(9).T @ regressor(9)
    values = [MEASURES[name](gram, sharpness)[0] for sharpness in (1.0, 4.0, 16.0, 256.0, np.inf)]
    assert all(blunt >= sharp for blunt, sharp in pairwise(values))
    assert values[-2] == pytest.approx(values[-1], abs=0.01)


def test_units_of_the_parameters_do_not_matter():
    phi = regressor(3)
    other = phi * np.exp(np.random.default_rng(1).standard_normal(SIZE))
    assert condition(phi.T @ phi, np.inf)[0] == pytest.approx(condition(other.T @ other, np.inf)[0])


@pytest.mark.parametrize("name", MEASURES)
def test_a_column_that_is_not_excited_costs_much_but_stays_finite(name):
    phi = regressor(2)
    phi[:, 4] = phi[:, 5]
    cost, gradient = MEASURES[name](phi.T @ phi, 4.0)
    whole, _ = MEASURES[name](regressor(2).T @ regressor(2), 4.0)
    assert np.isfinite(cost)
    assert np.all(np.isfinite(gradient))
    assert cost > whole
