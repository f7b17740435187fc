"""A joint that slides along gravity: its weight is gravity, what nothing determines has no error bar, units are N."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from lift import LIFT
from random_arms import random_arm

import dynid
from daq.robot.loader import parse_robot
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.model.true_parameters import truth_vector
from ident.result.models.model import Model

WEIGHT = 9.81 * 34.0
STILL = [0.0, 0.0]


@pytest.fixture(scope="module")
def model() -> Model:
    """An identified lift, whose links' masses the robot file estimates."""
    return dynid.identify(dynid.simulate(LIFT, duration=6.0, seed=1)).model


def test_the_consistent_model_has_its_weight_in_gravity(model):
    gravity, friction = model.gravity(STILL)[0], model.friction(STILL)[0]
    assert gravity == pytest.approx(WEIGHT, abs=0.06 * WEIGHT)
    assert gravity + friction == pytest.approx(WEIGHT + 5.0, abs=2.0)
    values = {p.name: p for p in model.result.consistent.parameters}
    assert gravity == pytest.approx(9.81 * (values["M1"].value + values["M2"].value))
    assert friction == pytest.approx(values["Fo1"].value)
    parts = model.torque_parts([0.1, 0.2], [0.1, 0.3], [1.0, 2.0])
    np.testing.assert_allclose(sum(parts.values()), model.torque([0.1, 0.2], [0.1, 0.3], [1.0, 2.0]))
    assert parts["gravity"] == pytest.approx(model.gravity([0.1, 0.2]))
    assert model.confounded == ()


@pytest.mark.usefixtures("estimate_alone")
def test_its_weight_needs_no_stated_masses():
    """Without them the links are as heavy as the lift's force shows, not as the arm's light torques do."""
    robot_file = parse_robot(LIFT.text.partition("prior:")[0], where="lift", folder=None)
    unstated = dynid.identify(dynid.simulate(robot_file, duration=6.0, seed=1)).model
    assert unstated.gravity(STILL)[0] == pytest.approx(WEIGHT, abs=0.06 * WEIGHT)


def test_what_no_motion_separates_has_no_error_bar(model):
    values = {p.name: p for p in model.result.consistent.parameters}
    for name in ("Fo1", "M1", "M2", "Ia1"):
        assert values[name].std is None
        assert values[name].determined < 0.999
    for name in ("Fo2", "Fs1", "Fv1", "MX2"):
        assert values[name].std is not None


def test_the_verdict_says_that_the_data_hold_the_sum_of_weight_and_friction(model):
    (check,) = [check for check in model.result.verdict.checks if check.name == "weight-not-separate"]
    gravity, friction = model.gravity(STILL)[0], model.friction(STILL)[0]
    assert f"lift {gravity:.3g} N of weight and {friction:.2g} N of friction" in check.text


def test_the_full_model_refuses_what_it_does_not_know(model):
    full = Model(model.result, "full")
    assert full.confounded == ("lift",)
    for part in (full.gravity, full.friction):
        with pytest.raises(dynid.ModelError, match=r"weight and offset of lift act alike \(together 3\d\d(\.\d)? N\)"):
            part(STILL)
    state = [0.1, 0.2], [0.1, 0.3], [1.0, 2.0]
    np.testing.assert_allclose(sum(full.torque_parts(*state).values()), full.torque(*state))
    np.testing.assert_allclose(full.torque(*state), model.torque(*state), atol=2.0)


def test_a_sliding_joint_has_its_own_units(model):
    units = {p.name: p.unit for p in model.result.consistent.parameters}
    assert [units[name] for name in ("Ia1", "Fv1", "Fs1", "Fo1")] == ["kg", "N·s/m", "N", "N"]
    assert [units[name] for name in ("Ia2", "Fv2", "Fs2", "Fo2")] == ["kg·m²", "N·m·s/rad", "N·m", "N·m"]


@pytest.mark.parametrize("seed", range(8))
def test_gravity_and_friction_of_bodies_are_the_true_ones_on_any_arm(seed):
    robot_file = random_arm(seed, sliding=0.6)
    model, truth = build_model(robot_file), truth_vector(robot_file)
    base = base_parameters(model)
    dynamics = InverseDynamics(model, base, base.projection @ truth, truth)
    bodies = InverseDynamics(model, *_all_standard(model, truth))
    q = np.random.default_rng(seed).uniform(-1, 1, (model.dof, 5))
    scale = np.abs(bodies.torque(q, q, q)).max()
    assert np.abs(dynamics.gravity(q) - bodies.gravity(q)).max() <= 1e-9 * scale
    assert np.abs(dynamics.friction(q) - bodies.friction(q)).max() <= 1e-9 * scale
    assert np.abs(dynamics.torque(q, q, q) - bodies.torque(q, q, q)).max() <= 1e-9 * scale


def _all_standard(model, truth):
    parameters = model.parameters
    base = replace(
        base_parameters(model),
        names=tuple(p.name for p in parameters),
        kinds=tuple(p.kind for p in parameters),
        columns=tuple(range(len(parameters))),
        projection=np.eye(len(parameters)),
    )
    return base, truth
