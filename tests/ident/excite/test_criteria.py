"""Criteria of a path: their values, and their derivatives through the regressor."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np
import pytest
from each import each

from ident.excite.criteria import (
    SIGN_SMOOTHING,
    MotionSize,
    RegressorCriterion,
    condition,
    d_optimal,
    deviations,
    e_optimal,
    moments_apart,
    plain_condition,
)
from ident.excite.path import JointPath
from ident.model.base_parameters import base_parameters
from ident.model.regressor import regressor


def random_path(dof: int, count: int, seed: int) -> JointPath:
    generator = np.random.default_rng(seed)
    return JointPath(np.arange(count) * 0.1, *generator.uniform(-2.0, 2.0, (3, dof, count)))


def moved(path: JointPath, quantity: int, joint: int, sample: int, step: float) -> JointPath:
    arrays = [path.position.copy(), path.velocity.copy(), path.acceleration.copy()]
    arrays[quantity][joint, sample] += step
    return JointPath(path.time, *arrays)


@pytest.mark.parametrize("measure", [plain_condition, condition])
@pytest.mark.parametrize("seed", range(3))
def test_derivatives_by_the_path_equal_finite_differences(random_tree, measure, seed):
    model = random_tree(seed, dof=3)
    base = base_parameters(model)
    criterion = RegressorCriterion(model, base.columns, measure, joint_weights=np.array([1.0, 2.0, 5.0]))
    path = random_path(3, 60, seed)
    _, gradient = criterion.smooth_cost(path, 4.0)
    for quantity in range(3):
        for joint in range(3):
            step = 1e-3
            ahead, behind = (
                criterion.smooth_cost(moved(path, quantity, joint, 7, sign * step), 4.0)[0] for sign in (1, -1)
            )
            assert gradient[quantity, joint, 7] == pytest.approx((ahead - behind) / (2 * step), rel=1e-3, abs=1e-6)


def test_cost_is_the_condition_of_the_stacked_weighted_regressor(ur_like):
    from ident.model.dynamic_model import build_model

    model = build_model(ur_like)
    base = base_parameters(model)
    weights = np.linspace(0.5, 3.0, model.dof)
    path = random_path(model.dof, 80, 1)
    dense = regressor(model, path.position, path.velocity, path.acceleration, base.columns)
    stacked = np.concatenate([weight * rows.T for weight, rows in zip(weights, dense, strict=True)])
    cost = RegressorCriterion(model, base.columns, plain_condition, weights).cost(path)
    assert np.exp(cost) == pytest.approx(np.linalg.cond(stacked), rel=1e-6)


def test_deviations_are_those_of_least_squares(ur_like):
    from ident.model.dynamic_model import build_model

    model = build_model(ur_like)
    base = base_parameters(model)
    noise = np.linspace(0.2, 2.0, model.dof)
    path = random_path(model.dof, 50, 2)
    size = np.exp(np.random.default_rng(3).standard_normal(base.count))
    dense = regressor(model, path.position, path.velocity, path.acceleration, base.columns)
    stacked = np.concatenate([rows.T / std for std, rows in zip(noise, dense, strict=True)])
    variances = np.diag(np.linalg.inv(stacked.T @ stacked)) * 50  # the criterion is per sample
    cost = RegressorCriterion(model, base.columns, deviations(size), 1.0 / noise).cost(path)
    assert np.exp(2 * cost) == pytest.approx(np.mean(variances / size**2), rel=1e-6)


def test_the_sign_of_the_velocity_is_smooth_in_the_smooth_cost_only(random_tree):
    model = dataclasses.replace(random_tree(1, dof=2), coulomb=(True, True), smoothing=0.0)
    path = random_path(2, 40, 4)
    slow = JointPath(path.time, path.position, path.velocity * 0.01 * SIGN_SMOOTHING, path.acceleration)
    still = JointPath(path.time, path.position, path.velocity * 1e-9, path.acceleration)
    criterion = RegressorCriterion(model, base_parameters(model).columns, condition)
    assert criterion.cost(slow) == pytest.approx(criterion.cost(still), rel=1e-3)
    assert np.any(criterion.smooth_cost(slow, 4.0)[1][1] != 0.0)


def test_motion_size_is_the_papers_formula_and_its_derivative():
    path = random_path(3, 30, 5)
    rows = np.concatenate([path.position, path.velocity, path.acceleration]).T
    criterion = MotionSize()
    assert np.exp(criterion.cost(path)) == pytest.approx(1.0 / np.linalg.norm(rows.T @ rows, 2))
    _, gradient = criterion.smooth_cost(path, 4.0)
    ahead, behind = (criterion.cost(moved(path, 1, 2, 9, sign * 1e-6)) for sign in (1, -1))
    assert gradient[1, 2, 9] == pytest.approx((ahead - behind) / 2e-6, rel=1e-5)


SIZE = 8
SCALE = np.exp(np.random.default_rng(5).standard_normal(SIZE))
MEASURES = {
    "plain_condition": plain_condition,
    "condition": condition,
    "d_optimal": d_optimal,
    "e_optimal": e_optimal,
    "deviations": deviations(SCALE),
    "moments_apart": moments_apart((0, 1, 2), (3, 4, 5, 6)),
}


def random_regressor(seed: int) -> np.ndarray:
    generator = np.random.default_rng(seed)
    return generator.standard_normal((40, SIZE)) * np.exp(generator.standard_normal(SIZE))


def unit(matrix: np.ndarray) -> np.ndarray:
    return matrix / np.linalg.norm(matrix, axis=0)


@each("sharpness", [1.0, 4.0, 64.0, np.inf])
@each("name", MEASURES)
def test_derivative_equals_finite_differences(name, sharpness):
    for seed in range(4):
        gram = random_regressor(seed).T @ random_regressor(seed)
        direction = np.random.default_rng(seed + 50).standard_normal((SIZE, SIZE))
        direction += direction.T
        _, gradient = MEASURES[name](gram, sharpness)
        step = 1e-6 * np.linalg.eigvalsh(gram)[0]
        ahead, behind = (MEASURES[name](gram + sign * step * direction, sharpness)[0] for sign in (1.0, -1.0))
        slope = (ahead - behind) / (2 * step)
        assert np.sum(gradient * direction) == pytest.approx(slope, rel=1e-5, abs=1e-7), seed
        assert np.allclose(gradient, gradient.T), seed


@each("seed", range(4))
def test_exact_values_are_what_they_say(seed):
    phi = random_regressor(seed)
    gram = phi.T @ phi
    exact = {name: measure(gram, np.inf)[0] for name, measure in MEASURES.items()}
    inverse = np.linalg.inv(gram)
    assert exact["plain_condition"] == pytest.approx(np.log(np.linalg.cond(phi)))
    assert exact["condition"] == pytest.approx(np.log(np.linalg.cond(unit(phi))))
    assert exact["d_optimal"] == pytest.approx(-np.linalg.slogdet(gram)[1] / SIZE)
    assert exact["e_optimal"] == pytest.approx(-np.log(np.linalg.svd(phi)[1][-1] ** 2))
    assert exact["deviations"] == pytest.approx(0.5 * np.log(np.mean(np.diag(inverse) / SCALE**2)))
    apart = np.linalg.cond(unit(phi[:, :3])) + np.linalg.cond(unit(phi[:, 3:7]))
    assert exact["moments_apart"] == pytest.approx(np.log(apart))


@each("name", ["plain_condition", "condition", "e_optimal", "moments_apart"])
def test_smooth_values_bound_the_exact_one_and_tend_to_it(name):
    gram = random_regressor(9).T @ random_regressor(9)
    values = [MEASURES[name](gram, sharpness)[0] for sharpness in (1.0, 4.0, 16.0, 256.0, np.inf)]
    assert all(blunt >= sharp for blunt, sharp in pairwise(values))
    assert values[-2] == pytest.approx(values[-1], abs=0.01)


def test_units_of_the_parameters_do_not_matter():
    phi = random_regressor(3)
    other = phi * np.exp(np.random.default_rng(1).standard_normal(SIZE))
    assert condition(phi.T @ phi, np.inf)[0] == pytest.approx(condition(other.T @ other, np.inf)[0])


@each("name", MEASURES)
def test_a_column_that_is_not_excited_costs_much_but_stays_finite(name):
    phi = random_regressor(2)
    phi[:, 4] = phi[:, 5]
    cost, gradient = MEASURES[name](phi.T @ phi, 4.0)
    whole, _ = MEASURES[name](random_regressor(2).T @ random_regressor(2), 4.0)
    assert np.isfinite(cost)
    assert np.all(np.isfinite(gradient))
    assert cost > whole
