"""Dahl's state in place of sign(q̇)."""

from __future__ import annotations

import numpy as np
import pytest
from friction_arm import arm_file

from ident.model.base_parameters import base_parameters, random_states
from ident.model.presliding import dahl_states, dahl_steps, dry_friction
from ident.model.true_parameters import true_model, truth_vector

RATE = 1000.0


def test_after_a_reversal_the_state_changes_sign_over_the_travel():
    velocity = np.concatenate([np.full(500, 0.2), np.zeros(50), np.full(300, -0.1), np.full(5, 0.1)])
    (state,) = dahl_states(velocity, RATE, [2e-3])
    back = 0.1 / RATE * np.arange(1, 301)
    assert np.allclose(state[:550], 1.0)
    assert np.allclose(state[550:850], -1.0 + 2.0 * np.exp(-back / 2e-3))
    assert np.all(np.diff(state[850:]) > 0.0)


def test_a_short_travel_is_the_sign_and_travels_do_not_mix():
    generator = np.random.default_rng(1)
    velocity = np.cumsum(generator.standard_normal(400)) + 0.05
    states = dahl_states(velocity, RATE, [1e-9, 1e-3, 0.1])
    assert np.allclose(states[0], np.sign(velocity))
    assert np.all(np.abs(states) <= 1.0)
    assert np.array_equal(dahl_states(velocity, RATE, [1e-3])[0], states[1])
    assert np.array_equal(dahl_states(-velocity, RATE, [0.1])[0], -states[2])
    assert not dahl_states(np.zeros(3), RATE, [1e-3]).any()
    rested = dahl_states(np.concatenate([np.zeros(3), velocity]), RATE, [0.1])
    assert np.array_equal(rested[:, 3:], dahl_states(velocity, RATE, [0.1], 0.0))
    assert not rested[:, :3].any()
    assert dahl_states(np.zeros(0), RATE, [1e-3]).shape == (1, 0)
    moved, travels, state = np.array([velocity, -velocity]) / RATE, np.array([1e-3, 0.1]), np.zeros(2)
    parts = [dahl_steps(moved[:, :150], travels, state)]
    parts.append(dahl_steps(moved[:, 150:], travels, parts[0][:, -1]))
    expected = [dahl_states(row * RATE, RATE, [travel], 0.0)[0] for row, travel in zip(moved, travels, strict=True)]
    assert np.allclose(np.concatenate(parts, axis=1), expected, atol=1e-12)


def test_all_terms_that_do_not_vanish_at_rest_follow_the_state():
    file = arm_file()
    model = true_model(file)
    base = base_parameters(model)
    dry = dry_friction(model, base, base.projection @ truth_vector(file, model))
    q, dq, _ = random_states(model, 200, 4)
    assert set(dry.columns) == {"Fs1", "Fs2", "Fs3"}
    change = dry.torque_change(dict.fromkeys(dry.columns, 1e-2), q, dq, RATE)
    load = dry.conditions(q).load_torque
    for joint, name in enumerate(model.joint_names):
        truth, speed = file.robot.truth.joints[name], np.abs(dq[joint])
        size = truth.coulomb + truth.stribeck * np.exp(-((speed / truth.stribeck_velocity) ** 2))
        if truth.load:
            size = size + truth.load * np.abs(load[joint]) ** (1 if name == "j3" else 2)
        expected = size * (dahl_states(dq[joint], RATE, [1e-2])[0] - np.sign(dq[joint]))
        assert np.any(expected)
        assert change[joint] == pytest.approx(expected, abs=1e-9)
    assert not dry.torque_change({}, q, dq, RATE).any()
