"""Backward elimination: what goes, what stays, and why it ends."""

from __future__ import annotations

import numpy as np
import pytest
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.core.errors import UsageError
from ident.regression.least_squares import ordinary_least_squares
from ident.regression.options import SIGNIFICANT_RSD, EssentialOptions
from ident.regression.pruning import partial_f, prune, pruned_covariance, relative_std


def system(dense_reduction, truth: np.ndarray, seed: int, rows: int = 400, noise: float = 1.0):
    generator = np.random.default_rng(seed)
    W = generator.standard_normal((rows, len(truth)))
    torque = W @ truth + noise * generator.standard_normal(rows)
    return dense_reduction([(W, torque)])


def pruned(
    reduction, rule="rsd", *, inflation: float = 1.0, effective: float | None = None, threshold: float = SIGNIFICANT_RSD
):
    count = reduction.column_count
    return prune(
        ordinary_least_squares(reduction, range(count)),
        np.full(count, inflation),
        reduction.rows if effective is None else effective,
        lambda columns: ordinary_least_squares(reduction, columns),
        rule,
        threshold,
    )


@settings(deadline=None, max_examples=40)
@given(
    seed=st.integers(0, 10_000),
    truth=st.lists(st.sampled_from([0.0, 0.01, 0.3, 5.0]), min_size=1, max_size=8),
    inflation=st.floats(0.5, 5.0),
    threshold=st.floats(1.0, 50.0),
    rule=st.sampled_from(["rsd", "f-test"]),
)
def test_dropped_and_kept_are_all_and_only_insignificant_ones_go(
    dense_reduction, seed, truth, inflation, threshold, rule
):
    reduction = system(dense_reduction, np.array(truth), seed)
    result = pruned(reduction, rule, inflation=inflation, threshold=threshold)
    limit = threshold if rule == "rsd" else 50.0  # every F at 5 % is above 3.84, every relative deviation below 51 %
    kept = result.solution.active
    assert sorted([*result.dropped, *kept]) == list(range(len(truth)))
    assert len(set(result.dropped)) == len(result.dropped)
    assert len(kept) >= 1
    # Each was insignificant in the model from which it was taken, and the worst there.
    active = list(range(len(truth)))
    for column in result.dropped:
        solution = ordinary_least_squares(reduction, active)
        rsd = relative_std(solution.parameters, inflation * solution.std)
        assert rsd[column] >= limit
        assert rsd[column] == np.max(rsd[active])
        active.remove(column)
    assert tuple(active) == kept
    if len(kept) > 1:
        rsd = relative_std(result.solution.parameters, inflation * result.solution.std)
        assert np.all(rsd[list(kept)] < (threshold if rule == "rsd" else 51.1))


def test_parameters_that_are_zero_go_and_large_ones_stay(dense_reduction):
    truth = np.array([5.0, 0.0, -3.0, 0.0, 0.0, 8.0])
    kept = [set(pruned(system(dense_reduction, truth, seed)).solution.active) for seed in range(30)]
    assert kept == [{0, 2, 5}] * 30


@each("threshold", [5.0, 15.0, 30.0, 45.0])
def test_the_threshold_acts(dense_reduction, threshold):
    """Parameters known to 2, 10, 20, 40 and 70 %: what is kept follows the threshold; the F-test's choice does not."""
    levels = np.array([2.0, 10.0, 20.0, 40.0, 70.0])
    columns = np.linalg.qr(np.random.default_rng(0).standard_normal((400, 5)))[0]
    noise = np.random.default_rng(1).standard_normal(400)
    noise -= columns @ (columns.T @ noise)  # the estimates are exact
    noise *= np.sqrt(395.0) / np.linalg.norm(noise)
    reduction = dense_reduction([(columns, columns @ (100.0 / levels) + noise)])
    kept = pruned(reduction, threshold=threshold).solution.active
    assert kept == tuple(np.flatnonzero(levels < threshold).tolist())
    assert pruned(reduction, "f-test", threshold=threshold).solution.active == (0, 1, 2, 3)


def test_the_f_test_keeps_what_the_threshold_drops(dense_reduction):
    """Known to 25 %, four standard deviations from 0: not significant by SR400's rule, but the fit suffers."""
    reduction = system(dense_reduction, np.array([5.0, 0.2]), 1)
    assert pruned(reduction).dropped == (1,)
    result = pruned(reduction, "f-test")
    assert result.stopped_by.startswith("partial F-test")
    assert result.dropped == ()


def test_few_effective_rows_make_the_f_test_lenient(dense_reduction):
    reduction = system(dense_reduction, np.array([5.0, 0.15]), 4)
    solution = ordinary_least_squares(reduction, range(2))
    assert (
        3.9 < partial_f(solution.parameters, solution.std)[1] < 18.0
    )  # the limits for 398 and for 1 degree of freedom
    assert pruned(reduction, "f-test").dropped == ()
    assert pruned(reduction, "f-test", effective=3.0).dropped == (1,)


@pytest.mark.parametrize("rule", ["rsd", "f-test"])
def test_inflated_standard_deviations_drop_more(dense_reduction, rule):
    reduction = system(dense_reduction, np.array([5.0, 0.2 if rule == "f-test" else 0.6]), 1)
    assert pruned(reduction, rule, inflation=1.0).dropped == ()
    assert pruned(reduction, rule, inflation=4.0).dropped == (1,)


def test_partial_f_is_the_loss_of_fit_without_the_parameter(dense_reduction):
    """Residual sums of squares of nested models, in variances of the larger one."""
    reduction = system(dense_reduction, np.array([5.0, 0.3, -0.1, 2.0]), 7)
    full = ordinary_least_squares(reduction, range(4))
    f_values = partial_f(full.parameters, full.std)
    for column in range(4):
        without = ordinary_least_squares(reduction, [other for other in range(4) if other != column])
        loss = without.residual_sum - full.residual_sum
        assert f_values[column] == pytest.approx(loss / (full.residual_sum / (full.rows - 4)), rel=1e-9)
    assert np.isnan(partial_f(np.array([1.0]), np.array([np.inf]))).all()


def test_a_rule_of_another_name_is_refused():
    with pytest.raises(UsageError, match=r"--essential 'ftest' does not exist .rsd or f-test."):
        EssentialOptions(essential="ftest")


def test_nothing_goes_when_all_are_below_the_threshold(dense_reduction):
    result = pruned(system(dense_reduction, np.array([5.0, 4.0, -6.0]), 1))
    assert result.dropped == ()
    assert result.stopped_by == "all below 15 %"


def test_the_last_parameter_stays_whatever_it_is(dense_reduction):
    result = pruned(system(dense_reduction, np.zeros(4), 3), threshold=0.001, effective=3.0)
    assert len(result.solution.active) >= 1
    assert len(result.dropped) + len(result.solution.active) == 4


def test_relative_std_of_what_has_no_value_is_infinite():
    rsd = relative_std(np.array([2.0, 0.0, -4.0, 1.0]), np.array([0.1, 0.1, 1.0, np.inf]))
    assert rsd == pytest.approx([5.0, np.inf, 25.0, np.inf])


def test_intervals_hold_the_truth_although_the_data_chose_what_is_dropped(dense_reduction):
    """Half of the parameters are about as large as their standard deviations, where selection does most harm."""
    parameters, predictions, of_submodel = [], [], []
    for seed in range(150):
        generator = np.random.default_rng(seed)
        W = generator.standard_normal((200, 10)) + 1.5 * generator.standard_normal((200, 1))
        truth = np.where(np.arange(10) < 5, 3.0, 0.1) * generator.standard_normal(10)
        reduction = dense_reduction([(W, W @ truth + generator.standard_normal(200))])
        full, essential = ordinary_least_squares(reduction, range(10)), pruned(reduction).solution
        covariance = pruned_covariance(full.covariance, essential.parameters - full.parameters)
        error = essential.parameters - truth
        parameters.append(np.abs(error) <= 1.96 * np.sqrt(np.diag(covariance)))
        row = W[:40]
        predictions.append(np.abs(row @ error) <= 1.96 * np.sqrt(np.sum(row @ covariance * row, axis=1)))
        kept = row[:, list(essential.active)]
        own = np.sqrt(np.sum(kept @ essential.covariance * kept, axis=1))
        of_submodel.append(np.abs(row @ error) <= 1.96 * own)
    assert np.mean(parameters) > 0.94
    assert np.mean(predictions) > 0.94
    assert np.mean(of_submodel) < 0.9


@given(
    values=st.lists(st.floats(-10.0, 10.0), min_size=1, max_size=6),
    dropped=st.sets(st.integers(0, 5)),
    seed=st.integers(0, 1000),
)
def test_no_combination_of_essential_parameters_is_surer_than_of_the_full_ones(values, dropped, seed):
    full = np.array(values)
    generator = np.random.default_rng(seed)
    root = generator.standard_normal((len(full), len(full)))
    essential = full + generator.standard_normal(len(full))
    essential[[i for i in dropped if i < len(full)]] = 0.0
    combination = generator.standard_normal(len(full))
    variance = combination @ pruned_covariance(root @ root.T, essential - full) @ combination
    assert variance == pytest.approx(
        np.sum((root.T @ combination) ** 2) + (combination @ (essential - full)) ** 2, rel=1e-9
    )
