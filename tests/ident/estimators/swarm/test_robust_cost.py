from __future__ import annotations

import numpy as np
import pytest

from daq.robot.loader import load_robot
from ident.estimators.swarm.box import Box
from ident.estimators.swarm.frog_leaping import FrogLeaping
from ident.estimators.swarm.minimisation import Budget, minimise
from ident.estimators.swarm.robust_cost import HUBER, TUKEY, FeasibilityPenalty, PenalisedCost, RobustCost
from ident.model.true_parameters import truth_vector

GENERATOR = np.random.default_rng(8)


@pytest.mark.parametrize("loss", ["absolute", "huber", "tukey"])
def test_outliers_do_not_move_a_robust_minimum(loss) -> None:
    rows, truth = GENERATOR.standard_normal((500, 2)), np.array([2.0, -1.0])
    torque = rows @ truth + 0.1 * GENERATOR.standard_normal(500)
    torque[:50] += 20.0 * np.sign(rows[:50, 0])
    cost = RobustCost(rows, torque, np.full(500, 0.1), loss)
    box = Box(np.full(2, -5.0), np.full(2, 5.0))
    found = minimise(FrogLeaping(random="coordinate"), cost, box, Budget(30))
    assert found.point == pytest.approx(truth, abs=0.03)
    assert np.linalg.lstsq(rows, torque, rcond=None)[0] != pytest.approx(truth, abs=0.05)


def test_losses_of_single_residuals() -> None:
    def loss(name, u: float) -> float:
        return float(RobustCost(np.ones((1, 1)), np.zeros(1), np.ones(1), name)(np.array([[u]]))[0])

    assert loss("huber", 0.5) == 0.125
    assert loss("huber", 10.0) == pytest.approx(HUBER * 10.0 - HUBER**2 / 2)
    assert loss("tukey", -50.0) == pytest.approx(TUKEY**2 / 6)
    assert loss("absolute", -3.0) == 3.0


def test_only_impossible_bodies_are_penalised() -> None:
    links = truth_vector(load_robot("up6"))[:30].reshape(3, 10)
    penalty = FeasibilityPenalty.of(links)
    impossible = links.copy()
    impossible[1, 9] = -1.0
    worse = links.copy()
    worse[1, 9] = -35.0
    costs = penalty(np.array([links, 0.1 * links, impossible, worse]))
    assert costs[:2] == pytest.approx(0.0)
    assert 0.0 < costs[2] < costs[3]
    whole = PenalisedCost(lambda points: points[:, -1], penalty, 100.0)
    points = np.column_stack([np.array([links, worse]).reshape(2, -1), [7.0, 7.0]])
    assert whole(points) == pytest.approx([7.0, 7.0 + 100.0 * costs[3]])
