from __future__ import annotations

import numpy as np
import pytest

from ident.estimators.swarm.box import Box
from ident.estimators.swarm.friction_shapes import ShapeCost, lugre_columns, stribeck_columns
from ident.estimators.swarm.minimisation import Budget, minimise
from ident.estimators.swarm.particle_swarm import ParticleSwarm

RATE = 200.0
TIME = np.arange(400) / RATE
VELOCITY = np.sin(2 * np.pi * 0.5 * TIME) + 0.3 * np.sin(2 * np.pi * 1.3 * TIME)
FIXED = np.column_stack([np.gradient(VELOCITY, 1 / RATE), np.sign(VELOCITY), np.ones_like(TIME)])
CASES = {
    "stribeck": (
        stribeck_columns(VELOCITY),
        np.array([0.6, 0.1, 1.5]),
        Box(np.array([0.2, 0.02, 0.5]), np.array([1.5, 0.5, 3.0])),
    ),
    "lugre": (
        lugre_columns(VELOCITY, RATE),
        np.array([80.0, 1.4, 0.1]),
        Box(np.array([10.0, 1.0, 0.02]), np.array([500.0, 3.0, 0.5])),
    ),
}


@pytest.fixture(params=CASES)
def case(request):
    columns, truth, box = CASES[request.param]
    torque = FIXED @ [2.0, 3.0, 0.5] + columns(truth[None])[0] @ [4.0, 0.3]
    return ShapeCost.of(FIXED, torque, columns), torque, truth, box


def test_the_cost_is_the_residual_of_least_squares_over_everything_else(case) -> None:
    cost, torque, _, box = case
    points = box.draw(np.random.default_rng(1), 4)
    wanted = []
    for columns in cost.columns(points):
        whole = np.column_stack([FIXED, columns])
        wanted.append(np.linalg.norm(torque - whole @ np.linalg.lstsq(whole, torque, rcond=None)[0]))
    assert cost(points) == pytest.approx(wanted, rel=1e-5, abs=1e-6)
    assert [np.linalg.norm(cost.residual(point)) for point in points] == pytest.approx(wanted, rel=1e-6)


def test_the_true_shapes_are_found(case) -> None:
    cost, _, truth, box = case
    assert cost.coefficients(truth) == pytest.approx([4.0, 0.3])
    # The Stribeck case has a second minimum, which a small swarm may end in.
    found = min(minimise(ParticleSwarm(20), cost, box, Budget(60), seed=seed).cost for seed in range(3))
    assert found < 0.02 * cost(box.draw(np.random.default_rng(1), 20)).min()


def test_shapes_that_overflow_have_no_cost() -> None:
    costs = ShapeCost.of(FIXED, VELOCITY, stribeck_columns(1e200 * VELOCITY))(np.array([[5.0, 0.1, 1.0]]))
    assert np.isnan(costs[0])


def test_bristles_reach_coulomb_friction_and_have_their_stiffness() -> None:
    slow = np.full(400, 1e-4)
    z = lugre_columns(slow, RATE)(np.array([[1e5, 1.0, 0.1], [10.0, 1.0, 0.1]]))[..., 0]
    assert z[0, -1] == pytest.approx(1.0)
    assert z[1, -1] == pytest.approx(10.0 * 1e-4 * 399 / RATE, rel=1e-2)
