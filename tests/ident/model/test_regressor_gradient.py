"""Derivatives of the regressor against finite differences of the kernel, on random trees."""

from __future__ import annotations

import dataclasses

import numpy as np
from each import each

from ident.model.regressor import RegressorKernel
from ident.model.regressor_gradient import pull_back_regressor

STEP = 1e-6


def weighted_sum(kernel, state, weights):
    packed = np.empty((kernel.row_count, state.shape[-1]))
    kernel.evaluate(*state, packed)
    return (weights * packed).sum(axis=0)


@each("smoothing", [0.0, 0.7])
@each("seed", range(12))
def test_pull_back_equals_finite_differences(random_tree, seed, smoothing):
    model = dataclasses.replace(random_tree(seed, dof=1 + seed % 7), smoothing=smoothing)
    generator = np.random.default_rng(seed)
    columns = None
    if seed % 2:
        count = len(model.parameters)
        columns = sorted(generator.choice(count, size=max(1, count // 2), replace=False))
    kernel = RegressorKernel(model, columns, chunk=16)
    state = generator.uniform(-2, 2, (3, model.dof, 5))  # fewer samples than the chunk
    weights = generator.standard_normal((kernel.row_count, 5))
    weighted_sum(kernel, state, weights)
    gradient = pull_back_regressor(kernel, *state, weights)
    for quantity in range(3):
        for joint in range(model.dof):
            step = np.zeros_like(state)
            step[quantity, joint] = STEP
            difference = weighted_sum(kernel, state + step, weights) - weighted_sum(kernel, state - step, weights)
            assert np.allclose(gradient[quantity, joint], difference / (2 * STEP), rtol=1e-6, atol=1e-5)


def test_a_joint_parameter_acts_on_its_own_joint_only(random_tree):
    model = dataclasses.replace(random_tree(3, dof=4), motor_inertia=(True,) * 4, viscous=(True,) * 4)
    names = [parameter.name for parameter in model.parameters]
    kernel = RegressorKernel(model, [names.index("Ia2"), names.index("Fv3")], chunk=3)
    state = np.random.default_rng(0).uniform(-1, 1, (3, 4, 3))
    weights = np.ones((2, 3))
    weighted_sum(kernel, state, weights)
    gradient = pull_back_regressor(kernel, *state, weights)
    expected = np.zeros((3, 4, 3))
    expected[2, 1] = expected[1, 2] = 1.0
    assert np.array_equal(gradient, expected)
