"""Motors that reverse: their equations are left out, nothing else, and friction that sticks there does no harm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from each import each

from drivers.core.errors import UsageError
from ident.assessment.delay.delay import search_delay
from ident.identify.identification import IdentifyChoices
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.regressor import RegressorKernel, regressor
from ident.model.true_parameters import truth_vector
from ident.regression.observation_matrix import filtered_samples, reduce_segments
from ident.regression.velocity_reversals import reversal_mask
from ident.signals.filters import butterworth, no_filter


@pytest.fixture(scope="module")
def arm(three_joint):
    model = build_model(three_joint)
    base = base_parameters(model)
    return model, base, base.projection @ truth_vector(three_joint)


@pytest.fixture(scope="module")
def segment(three_joint, arm, smooth_segment):
    return smooth_segment(arm[0], 3000, parameters=truth_vector(three_joint), seed=1)


def solved(kernel, segment) -> np.ndarray:
    stacked = reduce_segments(kernel, [segment], no_filter()).stacked()
    return np.linalg.lstsq(stacked[:, :-1], stacked[:, -1], rcond=None)[0]


def test_slow_motors_turn_and_fast_ones_do_not(arm, segment):
    model, base, _ = arm
    found = reversal_mask(RegressorKernel(model, base.columns), segment, 0.3)
    speed = np.abs(segment.velocity) / np.sqrt(np.mean(segment.velocity[:, segment.used] ** 2, axis=1, keepdims=True))
    rubbing = np.array(model.coulomb)
    assert rubbing.any()
    assert np.array_equal(found[rubbing], speed[rubbing] < 0.3)
    assert not found[~rubbing].any()


@pytest.mark.parametrize("zero_phase", [no_filter(), no_filter(3), butterworth(8.0, 100.0, factor=2)])
def test_just_their_equations_are_left_out(arm, segment, zero_phase):
    model, base, _ = arm
    kernel = RegressorKernel(model, base.columns, chunk=128)
    turns = reversal_mask(kernel, segment, 0.3)
    reduction = reduce_segments(kernel, [replace(segment, reversing=turns)], zero_phase)
    every = slice(None, None, zero_phase.factor)
    dense = zero_phase.apply(
        np.concatenate(
            [*regressor(model, segment.position, segment.velocity, segment.acceleration, base.columns), segment.torque]
        )
    )
    count = len(base.columns)
    for motor, joint in enumerate(reduction.joints):
        counts = segment.used[every] & ~turns[motor, every]
        rows = np.vstack([dense[motor * count : (motor + 1) * count], dense[model.dof * count + motor]])[:, counts]
        assert joint.rows == counts.sum()
        wide = np.zeros((len(joint.factor), count + 1))
        wide[:, [*joint.columns, -1]] = joint.factor
        assert np.allclose(wide.T @ wide, rows @ rows.T, rtol=1e-9, atol=1e-9 * np.trace(rows @ rows.T))


def test_what_the_kernel_keeps_between_chunks_is_not_touched(arm, segment):
    model, base, _ = arm
    kernel = RegressorKernel(model, base.columns, chunk=128)
    plain = [block.regressor.copy() for block in filtered_samples(kernel, segment, no_filter(), segment.torque)]
    turns = reversal_mask(kernel, segment, 0.5)
    list(filtered_samples(kernel, replace(segment, reversing=turns), no_filter(), segment.torque))
    again = [block.regressor.copy() for block in filtered_samples(kernel, segment, no_filter(), segment.torque)]
    assert all(np.array_equal(one, other) for one, other in zip(plain, again, strict=True))


def test_friction_that_sticks_at_reversals_does_no_harm(three_joint, arm, segment):
    model, base, truth = arm
    kernel = RegressorKernel(model, base.columns)
    turns = reversal_mask(kernel, segment, 0.2)
    torque = segment.torque.copy()
    for motor in range(model.dof):  # one sign too late: what a joint does that has to be torn loose
        slow = turns[motor]
        torque[motor, slow] -= 1.5 * np.sign(segment.velocity[motor, slow])
    stuck = replace(segment, torque=torque)
    kept, left_out = solved(kernel, stuck), solved(kernel, replace(stuck, reversing=turns))
    assert np.allclose(left_out, truth, rtol=1e-6, atol=1e-6)
    assert np.max(np.abs(kept - truth)) > 0.02


@each("share", [-0.1, 1.0, float("nan")])
def test_what_is_no_share_is_refused(share):
    with pytest.raises(UsageError, match=r"not within 0 to 0\.99|not a finite number"):
        IdentifyChoices(reversals=share)


@pytest.mark.parametrize("method", ["energy", "power"])
def test_it_is_refused_where_one_equation_is_the_whole_arm_s(method):
    with pytest.raises(UsageError, match="--reversals"):
        IdentifyChoices(method=method, reversals=0.2)


def test_friction_that_changes_late_is_no_delay(arm, segment):
    model, base, _ = arm
    kernel = RegressorKernel(model, base.columns)
    rate = np.sqrt(np.mean(segment.velocity**2, axis=1))
    torque = segment.torque + 0.05 * np.random.default_rng(1).standard_normal(segment.torque.shape)
    for motor in range(model.dof):
        # The old sign until the joint is a sixth of its usual speed: friction that has to be overcome first.
        sign = 0.0
        for sample, speed in enumerate(segment.velocity[motor] / rate[motor]):
            sign = np.sign(speed) if abs(speed) > 0.15 or sign == 0.0 else sign
            torque[motor, sample] += 3.0 * (sign - np.sign(speed))
    sticking = replace(segment, torque=torque)
    found = search_delay(kernel, [sticking], no_filter())
    assert abs(found.best) < 0.5e-3
    assert found.used == 0.0
