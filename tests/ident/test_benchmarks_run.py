"""The benchmarks run, and refuse to compare what does not agree. Nothing is timed here: that is what they are for."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.agreement import DisagreementError, check
from benchmarks.identification import accuracy, decimation, parameters, regressor, swarm
from benchmarks.models import c_code, simulation
from benchmarks.timing import medians


def test_medians_belong_to_their_sides_and_rounds_are_interleaved():
    order: list[str] = []
    seconds = medians({"a": lambda: order.append("a"), "b": lambda: order.append("b")}, 3)
    assert order == ["a", "b"] * 4  # one round to warm up
    assert set(seconds) == {"a", "b"}


def test_sides_that_differ_are_not_compared():
    check("equal", np.ones(3), np.ones(3), 0.0)
    with pytest.raises(DisagreementError, match="allowed"):
        check("different", np.array([1.0, 2.0]), np.array([1.0, 2.1]), 1e-3)
    with pytest.raises(DisagreementError, match="allowed"):
        check("not a number", np.array([np.nan]), np.array([1.0]), 1e-3)
    with pytest.raises(DisagreementError, match="shapes"):
        check("shapes", np.ones(3), np.ones(4), 1.0)


@pytest.mark.parametrize(
    ("run", "name"),
    [
        (regressor.run_pinocchio, "regressor_vs_pin_loop"),
        (parameters.run_pinocchio, "parameters_vs_pin_lstsq_200k"),
        (decimation.run, "decimation_vs_column_loop"),
        (swarm.run_rows, "swarm_cost_vs_rows"),
    ],
)
def test_both_sides_agree_on_few_samples(run, name):
    results = run(600, 1)
    assert results[name] > 0
    assert all(np.isfinite(list(results.values())))


def test_simulations_of_three_makers_end_at_the_same_place():
    results = simulation.run(0.2, 1)
    assert results["simulate_vs_pin_aba_loop_ur5e"] > 0
    assert all(np.isfinite(list(results.values())))


@pytest.mark.realtime
def test_c_code_sums_up_to_the_same_torques_as_python():
    results = c_code.run(1000, 1, ["sr400"])
    if not results:
        pytest.skip("no C compiler 'cc'")
    assert all(np.isfinite(list(results.values())))


def test_the_badly_conditioned_problem_is_as_badly_conditioned_as_it_says():
    from benchmarks.arm import arm

    given = accuracy.problem(arm(), seed=1, samples=1000)
    lengths = np.linalg.norm(given.matrix, axis=0)
    assert np.linalg.cond(given.matrix / lengths) == pytest.approx(accuracy.CONDITION, rel=0.1)
    assert np.allclose(given.matrix @ given.truth, given.segment.torque.ravel(), rtol=0, atol=1e-10)
