"""Inverse dynamics of base parameters through Pinocchio, against the regressor, on random arms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from each import each
from loop_arms import spatial_arm, spherical_arm

from ident.model.base_parameters import base_parameters, random_states
from ident.model.dynamic_model import build_model
from ident.model.dynamics import inverse_dynamics
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.model.regressor import model_torque


def agree(model, values):
    base = base_parameters(model)
    parameters = values(base)
    dynamics = InverseDynamics(model, base, parameters)
    state = random_states(model, 20, seed=4)
    expected = dynamics.coupling.T @ model_torque(model, base.columns, parameters, *state)
    scale = np.abs(expected).max()
    np.testing.assert_allclose(dynamics.torque(*state), expected, rtol=0, atol=1e-9 * scale)
    still = np.zeros_like(state[0])
    parts = np.einsum("Nij,jN->iN", dynamics.inertia(state[0]), state[2]) + dynamics.links(state[0], state[1], still)
    np.testing.assert_allclose(parts + dynamics.friction(state[1]), expected, rtol=0, atol=1e-9 * scale)


@each("seed", range(12))
def test_random_trees_with_any_parameters(random_tree, seed):
    generator = np.random.default_rng(seed)
    agree(random_tree(seed), lambda base: generator.standard_normal(base.count))


@pytest.mark.parametrize("arm", [spatial_arm, spherical_arm])
def test_loops_that_close_numerically(arm):
    generator = np.random.default_rng(1)
    agree(build_model(arm()), lambda base: generator.standard_normal(base.count))


def test_a_kept_mass_of_zero(random_tree):
    model = next(
        tree
        for tree in (random_tree(seed) for seed in range(50))
        if any(name.startswith("M") and name.lstrip("MR").isdigit() for name in base_parameters(tree).names)
    )

    def without_masses(base):
        values = np.random.default_rng(2).standard_normal(base.count)
        return np.where([name.lstrip("MR").isdigit() for name in base.names], 0.0, values)

    agree(model, without_masses)


def test_few_and_many_samples_agree(random_tree, monkeypatch):
    model = replace(random_tree(3), smoothing=0.05)
    base = base_parameters(model)
    dynamics = InverseDynamics(model, base, np.ones(base.count))
    state = random_states(model, 7)
    few = dynamics.torque(*state)
    monkeypatch.setattr(inverse_dynamics, "LOOP_BELOW", 1)
    np.testing.assert_allclose(dynamics.torque(*state), few, rtol=1e-9, atol=1e-9)
