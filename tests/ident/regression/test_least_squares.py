"""Least squares on the reduced system against the textbook on the full one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.core.errors import IdentificationError
from ident.linear_algebra.triangular import triangular
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.regressor import RegressorKernel, regressor
from ident.model.true_parameters import truth_vector
from ident.regression import least_squares
from ident.regression.least_squares import excited_columns, ordinary_least_squares, weighted_least_squares
from ident.regression.observation_matrix import JointFactor, Reduction, only_torques, reduce_segments
from ident.signals.filters import no_filter

NOISE = np.array([3.0, 0.3, 0.03])
"""Standard deviations of three joints' torques [N·m], as unequal as a shoulder's and a wrist's."""


def systems(seed: int, count: int = 5, rows: int = 200, noise: np.ndarray = NOISE):
    """True parameters, and W (rows, count) and torque (rows,) of each joint."""
    generator = np.random.default_rng(seed)
    truth = generator.standard_normal(count)
    joints = []
    for std in noise:
        W = generator.standard_normal((rows, count))
        joints.append((W, W @ truth + std * generator.standard_normal(rows)))
    return truth, joints


def stacked(joints, weights=(1.0, 1.0, 1.0)):
    return (
        np.vstack([weight * W for weight, (W, _) in zip(weights, joints, strict=True)]),
        np.concatenate([weight * torque for weight, (_, torque) in zip(weights, joints, strict=True)]),
    )


@each("seed", range(5))
def test_ols_is_lstsq_with_the_classical_covariance(dense_reduction, seed):
    _, joints = systems(seed)
    W, torque = stacked(joints)
    solution = ordinary_least_squares(dense_reduction(joints), range(5))
    expected, residual_sum, _, singular = np.linalg.lstsq(W, torque, rcond=None)
    assert np.allclose(solution.parameters, expected, rtol=1e-10, atol=1e-12)
    assert solution.residual_sum == pytest.approx(residual_sum[0], rel=1e-10)
    variance = residual_sum[0] / (len(W) - 5)  # SR400 eq. 14
    assert np.allclose(solution.covariance, variance * np.linalg.inv(W.T @ W), rtol=1e-9, atol=1e-15)
    assert solution.condition == pytest.approx(singular[0] / singular[-1], rel=1e-9)
    assert solution.rows == len(W)
    assert np.array_equal(solution.weights, np.ones(3))


@pytest.mark.parametrize("seed", range(5))
def test_ols_covariance_is_the_spread_over_white_noise(dense_reduction, seed):
    generator = np.random.default_rng(seed)
    truth, joints = systems(seed, noise=np.zeros(3))
    found, covariance = [], []
    for _ in range(300):
        noisy = [(W, torque + 0.5 * generator.standard_normal(len(torque))) for W, torque in joints]
        solution = ordinary_least_squares(dense_reduction(noisy), range(5))
        found.append(solution.parameters)
        covariance.append(np.diag(solution.covariance))
    ratio = np.sqrt(np.mean(covariance, axis=0)) / np.std(np.array(found) - truth, axis=0)
    assert np.all(np.abs(ratio - 1.0) < 0.2)  # 300 draws know a standard deviation to 4 %


@each("seed", range(5))
def test_wls_is_the_fixed_point_of_its_weights(dense_reduction, seed):
    _, joints = systems(seed)
    solution = weighted_least_squares(dense_reduction(joints), range(5))
    assert np.allclose(solution.weights, 1.0 / solution.joint_std, rtol=1e-6)
    W, torque = stacked(joints, solution.weights)
    expected, residual_sum, _, _ = np.linalg.lstsq(W, torque, rcond=None)
    assert np.allclose(solution.parameters, expected, rtol=1e-8, atol=1e-10)
    assert residual_sum[0] / (len(W) - 5) == pytest.approx(1.0, rel=1e-6)  # weighted residuals have unit variance
    for (rows, measured), std in zip(joints, solution.joint_std, strict=True):
        freedom = len(measured) * (1 - 5 / len(W))
        assert std == pytest.approx(np.sqrt(np.sum((measured - rows @ solution.parameters) ** 2) / freedom), rel=1e-9)


def test_wls_finds_the_joints_noise_and_beats_ols(dense_reduction):
    errors = {"ols": [], "wls": []}
    for seed in range(40):
        truth, joints = systems(seed)
        reduction = dense_reduction(joints)
        weighted = weighted_least_squares(reduction, range(5))
        assert np.allclose(weighted.joint_std, NOISE, rtol=0.25)
        errors["ols"].append(ordinary_least_squares(reduction, range(5)).parameters - truth)
        errors["wls"].append(weighted.parameters - truth)
    ols, wls = (float(np.sqrt(np.mean(np.square(errors[method])))) for method in ("ols", "wls"))
    assert wls < 0.1 * ols
    # The best linear estimate knows the noise: σ of the best joint alone is 0.03/√200.
    assert wls < 1.3 * 0.03 / np.sqrt(200)


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 10_000), factors=st.tuples(*[st.floats(1e-3, 1e3)] * 3))
def test_wls_does_not_depend_on_a_joints_unit(dense_reduction, seed, factors):
    """Weights belong to joints: an error in their order or number would show here."""
    _, joints = systems(seed, count=3, rows=60)
    rescaled = [(factor * W, factor * torque) for factor, (W, torque) in zip(factors, joints, strict=True)]
    plain = weighted_least_squares(dense_reduction(joints), range(3))
    other = weighted_least_squares(dense_reduction(rescaled), range(3))
    assert np.allclose(other.parameters, plain.parameters, rtol=0, atol=1e-5 * np.max(np.abs(plain.parameters)))
    assert np.allclose(other.joint_std, plain.joint_std * factors, rtol=1e-4)


def test_methods_agree_without_noise(dense_reduction):
    truth, joints = systems(1, noise=np.zeros(3))
    for method in (ordinary_least_squares, weighted_least_squares):
        assert np.allclose(method(dense_reduction(joints), range(5)).parameters, truth, rtol=0, atol=1e-9)


def test_a_subset_is_estimated_as_if_the_others_did_not_exist(dense_reduction):
    _, joints = systems(2)
    W, torque = stacked(joints)
    solution = ordinary_least_squares(dense_reduction(joints), (0, 3))
    assert np.allclose(solution.parameters[[0, 3]], np.linalg.lstsq(W[:, [0, 3]], torque, rcond=None)[0], rtol=1e-9)
    assert np.array_equal(solution.parameters[[1, 2, 4]], np.zeros(3))
    assert np.array_equal(np.isinf(solution.std), [False, True, True, False, True])


def test_columns_that_others_explain_are_not_excited(dense_reduction):
    _, joints = systems(3)
    joints = [(np.column_stack([W, W[:, 0] - 2 * W[:, 3], np.zeros(len(W)), 1e-6 * W[:, 1]]), t) for W, t in joints]
    assert excited_columns(dense_reduction(joints)) == (0, 1, 2, 3, 4)


def test_weights_that_do_not_settle_give_the_last_iterate(dense_reduction, monkeypatch):
    _, joints = systems(4)
    assert weighted_least_squares(dense_reduction(joints), range(5)).settled
    monkeypatch.setattr(least_squares, "WLS_ITERATIONS", 1)
    last = weighted_least_squares(dense_reduction(joints), range(5))
    assert not last.settled
    W, torque = stacked(joints, 1.0 / ordinary_least_squares(dense_reduction(joints), range(5)).joint_std)
    assert np.allclose(last.parameters, np.linalg.lstsq(W, torque, rcond=None)[0], rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("method", [ordinary_least_squares, weighted_least_squares])
def test_dependent_columns_are_refused(dense_reduction, method):
    _, joints = systems(3)
    joints = [(np.column_stack([W, W[:, 0] - 2 * W[:, 3]]), torque) for W, torque in joints]
    with pytest.raises(IdentificationError, match="linearly dependent"):
        method(dense_reduction(joints), range(6))


@each("method", [ordinary_least_squares, weighted_least_squares])
@each(("rows", "message"), [(0, "no sample counts"), (1, "3 equations cannot determine 6 parameters")])
def test_fewer_equations_than_parameters_are_refused(dense_reduction, method, rows, message):
    _, joints = systems(3, count=6, rows=rows)
    with pytest.raises(IdentificationError, match=message):
        method(dense_reduction(joints), range(6))


def test_a_joint_that_never_moves_takes_its_columns_along_and_leaves_the_others_right(three_joint, smooth_segment):
    model = build_model(three_joint)
    base = base_parameters(model)
    segment = smooth_segment(model, 2000)
    position, velocity, acceleration = (
        getattr(segment, name).copy() for name in ("position", "velocity", "acceleration")
    )
    position[1], velocity[1], acceleration[1] = 0.7, 0.0, 0.0
    full = regressor(model, position, velocity, acceleration)
    torque = np.einsum("npN,p->nN", full, truth_vector(three_joint))
    still = replace(segment, position=position, velocity=velocity, acceleration=acceleration, torque=torque)
    reduction = reduce_segments(RegressorKernel(model, base.columns), [still], no_filter())
    active = excited_columns(reduction)
    lost = {base.names[i] for i in range(base.count) if i not in active}
    assert {"Fv2", "Fs2"} <= lost
    solution = weighted_least_squares(reduction, active)
    truth = base.projection @ truth_vector(three_joint)
    for name in ("Fv1", "Fv3", "Fs1", "Fs3", "Fo1", "Ia3", "MX3", "MY3"):
        i = base.names.index(name)
        assert i in active
        assert solution.parameters[i] == pytest.approx(truth[i], rel=1e-6, abs=1e-7)
    assert np.sqrt(reduction.residual_sums(solution.parameters).sum()) < 1e-6 * np.linalg.norm(torque)


@pytest.mark.parametrize("solve", [ordinary_least_squares, weighted_least_squares])
def test_joints_without_rows_take_no_part(dense_reduction, solve):
    generator = np.random.default_rng(8)
    joints = []
    for std in (5.0, 0.01, 0.3):
        w = generator.standard_normal((200, 4))
        joints.append((w, w @ [1.0, -2.0, 3.0, 0.5] + std * generator.standard_normal(200)))
    whole, alone = dense_reduction(joints), dense_reduction([joints[0], joints[2]])
    found, expected = solve(only_torques(whole, (0, 2)), range(4)), solve(alone, range(4))
    assert found.rows == 400
    assert np.allclose(found.parameters, expected.parameters, rtol=1e-12)
    assert np.allclose(found.covariance, expected.covariance, rtol=1e-10)
    assert found.weights[1] == 0.0
    assert np.allclose(found.weights[[0, 2]], expected.weights)


def held(seed: int, rows: int, noise: float = 0.05) -> Reduction:
    """Three joints with columns of their own; the last has few rows, and columns that the others hardly see."""
    generator = np.random.default_rng(seed)
    shared, own = np.array([1.0, 1.0, 1e-3, 1e-3]), 3
    factors = []
    for joint, count in enumerate((400, 400, rows)):
        columns = (0, 1, 2, 3, *range(4 + own * joint, 4 + own * (joint + 1)))
        seen = (
            generator.standard_normal((count, len(columns))) * np.r_[np.ones(4) if joint == 2 else shared, np.ones(own)]
        )
        torque = seen.sum(axis=1) + noise * generator.standard_normal(count)
        factors.append(JointFactor(columns, triangular(np.column_stack([seen, torque])), count))
    return Reduction(tuple(factors), 4 + 3 * own, 1, 400, "given")


@pytest.mark.parametrize("rows", [5, 6, 8, 12])
def test_a_joint_of_few_equations_gets_no_weight_beyond_its_noise(rows):
    """It may follow them exactly; unbounded, its weight would let its few equations overrule all others."""
    found = [weighted_least_squares(held(seed, rows), range(13)).joint_std for seed in range(40)]
    assert all(std[2] > 0.2 * 0.05 for std in found)
    np.testing.assert_allclose(np.median(found, axis=0)[:2], 0.05, rtol=0.1)


def test_a_joint_of_many_equations_keeps_its_own_deviation():
    reduction = held(1, 400)
    found = weighted_least_squares(reduction, range(13))
    rows = np.array([joint.rows for joint in reduction.joints])
    expected = np.sqrt(reduction.residual_sums(found.parameters) / (rows * (1.0 - 13 / rows.sum())))
    np.testing.assert_allclose(found.joint_std, expected, rtol=1e-3)
