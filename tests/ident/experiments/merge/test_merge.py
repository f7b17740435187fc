"""Merging estimates is least squares over all of their data, and says whether they can be true together."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.core.errors import IdentificationError
from ident.experiments.merge.merge import Information, identifiable_columns, merge, usable, variance_ratio
from ident.linear_algebra.triangular import triangular
from ident.regression.estimate import estimate_of
from ident.regression.least_squares import excited_columns, ordinary_least_squares, weighted_least_squares
from ident.regression.observation_matrix import stack_reductions

BLOCKS = 1_000_000


def joint_rows(seed, count=6, rows=400, noise=(0.5, 0.02), truth=None, scale=None):
    """Two joints' rows (W, τ) of a system whose columns differ by orders of magnitude."""
    generator = np.random.default_rng(seed)
    truth = np.arange(1.0, count + 1) if truth is None else truth
    scale = 10.0 ** np.linspace(-3, 3, count) if scale is None else scale
    joints = []
    for std in noise:
        w = generator.standard_normal((rows, count)) * scale
        joints.append((w, w @ truth + std * generator.standard_normal(rows)))
    return joints


def informed(reduction, solution, combinations=None):
    """A solution as information about the same parameters, residuals taken as white."""
    estimate = estimate_of(reduction, solution, solution.covariance, BLOCKS)
    combined = estimate.combinations(np.eye(reduction.column_count)) if combinations is None else combinations
    return Information(estimate.values, combined, estimate.root, estimate.covariance, BLOCKS)


def with_weights(reduction, weights):
    """OLS of the rows times their weights, with unit variance."""
    from dataclasses import replace

    weighted = replace(
        reduction,
        joints=tuple(
            replace(joint, factor=joint.factor * weight)
            for joint, weight in zip(reduction.joints, weights, strict=True)
        ),
    )
    return weighted, ordinary_least_squares(weighted, range(reduction.column_count))


def test_two_halves_merge_to_the_least_squares_of_all_data(dense_reduction):
    """They agree to 1e-8 of a standard deviation with the same weights; columns differ by six orders of magnitude."""
    halves = [dense_reduction(joint_rows(seed)) for seed in (1, 2)]
    weights = np.array([1 / 0.5, 1 / 0.02])
    together, whole = with_weights(stack_reductions(halves), weights)
    parts = []
    for half in halves:
        weighted, solution = with_weights(half, weights)
        root = triangular(weighted.stacked()[:, :6])[:6]
        inverse = np.linalg.inv(root.T @ root)
        parts.append(Information(solution.parameters, np.eye(6), root, inverse, BLOCKS))
    merged = merge(parts, range(6))
    assert np.max(np.abs(merged.solution.parameters - whole.parameters) / np.sqrt(np.diag(whole.inverse))) < 1e-8
    assert np.allclose(merged.covariance, whole.inverse, rtol=1e-7)
    assert np.allclose(np.abs(merged.root), np.abs(triangular(together.stacked()[:, :6])[:6]), rtol=1e-7, atol=1e-9)
    # Residuals add up as well: what the halves left, and what the merge adds to it.
    left = sum(with_weights(half, weights)[1].residual_sum for half in halves)
    assert left + merged.solution.residual_sum == pytest.approx(whole.residual_sum, rel=1e-10)


def test_merging_is_as_good_in_any_order_and_in_steps(dense_reduction):
    parts = []
    for seed in (1, 2, 3):
        reduction = dense_reduction(joint_rows(seed))
        parts.append(informed(reduction, weighted_least_squares(reduction, range(6))))
    at_once, turned = merge(parts, range(6)), merge(parts[::-1], range(6))
    std = np.sqrt(np.diag(at_once.covariance))
    assert np.max(np.abs(at_once.solution.parameters - turned.solution.parameters) / std) < 1e-7
    first = merge(parts[:2], range(6))
    prior = Information(first.solution.parameters, np.eye(6), first.root, first.covariance, BLOCKS)
    in_steps = merge([prior, parts[2]], range(6))
    assert np.max(np.abs(at_once.solution.parameters - in_steps.solution.parameters) / std) < 1e-7
    assert np.allclose(at_once.covariance, in_steps.covariance, rtol=1e-7)


@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 10_000), first=st.integers(1, 5), second=st.integers(1, 5))
def test_exact_values_of_combinations_give_the_exact_parameters(seed, first, second):
    """Whatever the combinations: what they determine comes out, and what they do not is taken up as it says."""
    generator = np.random.default_rng(seed)
    truth = generator.standard_normal(5) * 10.0 ** generator.uniform(-2, 2, 5)
    parts = []
    for count in (first, second):
        combined = generator.standard_normal((count, 5)) / 10.0 ** generator.uniform(-2, 2, 5)
        root = np.triu(generator.standard_normal((count, count))) + 3 * np.eye(count)
        covariance = np.linalg.inv(root.T @ root)
        parts.append(Information(combined @ truth, combined, root, covariance, BLOCKS))
    told = identifiable_columns(parts, range(5))
    assert len(told) == min(5, first + second)
    merged = merge(parts, told)
    others = [column for column in range(5) if column not in told]
    expected = truth[list(told)] + merged.absorbed @ truth[others]
    scale = np.abs(truth[list(told)]) + np.abs(merged.absorbed) @ np.abs(truth[others])
    assert np.max(np.abs(merged.solution.parameters[list(told)] - expected) / scale) < 1e-6
    # … and so another experiment that tells the rest apart completes them.
    rest = Information(truth, np.eye(5), np.eye(5), np.eye(5), BLOCKS)
    prior = Information(
        merged.solution.parameters[list(told)],
        np.eye(5)[list(told)] + merged.absorbed @ np.eye(5)[others],
        merged.root,
        merged.covariance,
        BLOCKS,
    )
    complete = merge([prior, rest], range(5))
    assert np.max(np.abs(complete.solution.parameters - truth)) < 1e-6 * np.max(np.abs(truth))


def test_error_bars_come_from_the_covariances_not_from_the_weights():
    """Wrong weights cost accuracy, not honesty: x = Σ G·θ has the covariance Σ G·C·Gᵀ."""
    true_std = np.array([0.1, 0.7])

    def merged(values):
        parts = [
            Information(np.array([value]), np.eye(1), np.eye(1), np.array([[std**2]]), BLOCKS)
            for value, std in zip(values, true_std, strict=True)
        ]
        return merge(parts, [0])

    shares = np.array([merged(values).solution.parameters[0] for values in np.eye(2)])
    assert shares.sum() == pytest.approx(1.0)
    both = merged((2.1, 1.6))
    assert both.solution.parameters[0] == pytest.approx(shares @ (2.1, 1.6))
    assert both.covariance[0, 0] == pytest.approx(np.sum((shares * true_std) ** 2), rel=1e-9)


def test_estimates_that_belong_together_pass_and_others_do_not(dense_reduction):
    """5 % of consistent pairs fall below p = 0.05; a shift of one parameter by ten deviations never passes."""
    low = 0
    for seed in range(200):
        reductions = [dense_reduction(joint_rows(2 * seed + part, rows=120)) for part in (0, 1)]
        parts = [informed(each, weighted_least_squares(each, range(6))) for each in reductions]
        test = merge(parts, range(6)).consistency
        assert test is not None
        assert test.freedom == 6
        low += test.p_value < 0.05
    assert 2 <= low <= 22
    values = parts[1].values.copy()
    values[4] += 10.0 * np.sqrt(parts[0].covariance[4, 4] + parts[1].covariance[4, 4])
    spoilt = merge([parts[0], Information(values, np.eye(6), parts[1].root, parts[1].covariance, BLOCKS)], range(6))
    assert spoilt.consistency is not None
    assert not spoilt.consistency.passed
    assert np.argmax(np.abs(spoilt.deviations[1])) == 4
    assert spoilt.deviations[1][4] == pytest.approx(10.0, abs=3.0)
    assert spoilt.deviations[0][4] == pytest.approx(-spoilt.deviations[1][4], rel=0.1)


def test_few_blocks_leave_a_test_by_the_mean_variance(dense_reduction):
    reductions = [dense_reduction(joint_rows(seed)) for seed in (1, 2)]
    parts = [informed(each, weighted_least_squares(each, range(6))) for each in reductions]
    few = [Information(p.values, p.combinations, p.root, p.covariance, 8) for p in parts]
    many, test = merge(parts, range(6)).consistency, merge(few, range(6)).consistency
    assert many is not None
    assert test is not None
    assert test.freedom == 6
    assert test.statistic == pytest.approx(many.statistic, rel=1e-6)


def test_experiments_that_share_nothing_cannot_be_compared():
    parts = [
        Information(np.array([1.0]), np.array([[1.0, 0.0]]), np.eye(1), np.eye(1), BLOCKS),
        Information(np.array([2.0]), np.array([[0.0, 1.0]]), np.eye(1), np.eye(1), BLOCKS),
    ]
    merged = merge(parts, [0, 1])
    assert merged.consistency is None
    assert np.all(np.concatenate(merged.deviations) == 0.0)
    assert merged.solution.parameters == pytest.approx([1.0, 2.0])


def test_a_value_without_variance_is_as_if_never_asked_for(dense_reduction):
    reduction = dense_reduction(joint_rows(5))
    solution = weighted_least_squares(reduction, range(6))
    estimate = estimate_of(reduction, solution, solution.covariance, BLOCKS)
    covariance = solution.covariance.copy()
    covariance[2, 2] = np.inf
    left = usable(Information(estimate.values, np.eye(6), estimate.root, covariance, BLOCKS))
    kept = [0, 1, 3, 4, 5]
    marginal = np.linalg.inv(solution.covariance[np.ix_(kept, kept)])
    assert np.allclose(left.root.T @ left.root, marginal, rtol=1e-6)
    assert np.array_equal(left.values, estimate.values[kept])
    assert variance_ratio(left.root, left.covariance) == pytest.approx(1.0)
    with pytest.raises(IdentificationError, match="standard deviation"):
        usable(Information(np.ones(1), np.eye(1), np.eye(1), np.full((1, 1), np.inf), BLOCKS))


@pytest.mark.parametrize("active", [[0, 1], [0]])
def test_what_the_values_do_not_determine_is_refused(active):
    combined = np.array([[1.0, 1.0]]) if len(active) == 2 else np.array([[0.0, 1.0]])
    part = Information(np.ones(1), combined, np.eye(1), np.eye(1), BLOCKS)
    with pytest.raises(IdentificationError, match="do not determine"):
        merge([part], active)
    with pytest.raises(IdentificationError, match="same combination"):
        merge([Information(np.ones(2), np.ones((2, 2)), np.eye(2), np.eye(2), BLOCKS)], [0, 1])


def test_what_a_column_that_was_not_excited_left_in_the_others(dense_reduction):
    """τ = W·x exactly, the last column a combination of two others: the estimate says of what it is the value."""
    generator = np.random.default_rng(4)
    truth = np.array([3.0, -2.0, 0.5, 7.0])
    w = generator.standard_normal((50, 4)) * [1.0, 1e-3, 1e3, 1.0]
    w[:, 3] = 0.3 * w[:, 0] - 40.0 * w[:, 1]
    reduction = dense_reduction([(w, w @ truth + 1e-9 * generator.standard_normal(50))])
    active = excited_columns(reduction)
    assert active == (0, 1, 2)
    solution = ordinary_least_squares(reduction, active)
    estimate = estimate_of(reduction, solution, solution.covariance, BLOCKS)
    assert estimate.absorbed[:, 0] == pytest.approx([0.3, -40.0, 0.0], abs=1e-9)
    assert estimate.combinations(np.eye(4)) @ truth == pytest.approx(solution.parameters[:3], rel=1e-6)
    assert np.linalg.inv(estimate.root.T @ estimate.root) == pytest.approx(solution.covariance, rel=1e-6)
