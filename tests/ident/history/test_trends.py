"""Trends and steps of arms that wear and warm, and of arms that do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arm_histories import entry, worn_arm

from ident.history.arm import arm_history
from ident.history.trend import Series, estimate_trend
from ident.views.history_tables import notes, sentences, span_text, step_table, trend_table


def test_the_true_wear_of_200_results_lies_in_its_interval():
    hits = 0
    for seed in range(1000, 1020):
        history = arm_history("a", worn_arm(seed, 200, {"Fs1": 0.12}))
        (one,) = history.parameters
        assert one.significant
        assert one.trend.change_half < 0.04
        hits += abs(one.trend.change - 0.12) <= one.trend.change_half
    assert hits >= 18


def test_arms_that_do_not_change_have_hardly_a_finding():
    found = sum(
        bool(arm_history("a", worn_arm(seed, 20, dict.fromkeys(("Fs1", "Fs2", "Fs3"), 0.0))).findings)
        for seed in range(20)
    )
    assert found <= 2


def test_a_step_is_found_where_it_is_and_a_slow_wear_is_none():
    entries = worn_arm(3, 100, {"Fs1": 0.0}, step=0.3)
    (one,) = arm_history("a", entries).parameters
    (step,) = one.trend.steps
    assert abs(step.size - 0.3) <= step.half
    assert step.before <= entries[50].time <= step.after + 1.0
    assert len(step_table(arm_history("a", entries))) == 1
    assert arm_history("a", worn_arm(3, 100, {"Fs1": 0.3})).parameters[0].trend.steps == ()


def test_a_change_is_said_in_words():
    history = arm_history("a", worn_arm(1, 60, {"Fs1": 0.0, "Fs2": 0.2, "Fs3": 0.0}, days=42.0, scatter=0.005))
    (said,) = sentences(history)
    assert said.startswith("j2's Coulomb friction rose by ")
    assert said.endswith(" % in 6 weeks.")
    row = trend_table(history).row("Fs2")
    assert row["significant"] is True
    assert row["change_percent"] == pytest.approx(20.0, abs=5.0)
    assert row["per_kelvin"] < 0


def test_wear_and_warming_that_go_together_have_no_trend():
    warm = [entry(k, k, {"Fs1": (1.0 - 0.01 * k, 0.01)}, 20.0 + k) for k in range(10)]
    history = arm_history("a", warm)
    assert history.parameters[0].trend is None
    assert "temperatures" in sentences(history)[0]


def test_what_is_not_comparable_or_repeated_is_left_out():
    entries = worn_arm(1, 10, {"Fs1": 0.0})
    other = [replace(value, basis="gain 2", value=9.0) for value in entries[4].values]
    entries[4] = replace(entries[4], values=tuple(other))
    again = replace(entries[5], digest="again", created="2026-02-01")
    history = arm_history("a", [*entries[:6], again, *entries[6:]])
    assert (history.results, history.repeated) == (10, 1)
    assert len(history.parameters[0].series) == 9
    assert history.parameters[0].not_comparable == 1
    assert len(notes(history)) == 3


def test_the_interval_does_not_depend_on_units_of_value_and_time():
    rng = np.random.default_rng(0)
    time, value, std = np.sort(rng.uniform(0, 1, 20)), rng.normal(5, 0.1, 20), rng.uniform(0.05, 0.1, 20)
    unknown = np.full(20, np.nan)
    plain = estimate_trend(Series(time, value, std, unknown), 0.001)
    other = estimate_trend(Series(1e9 + 1e7 * time, 1e-6 * value, 1e-6 * std, unknown), 0.001)
    assert other.change == pytest.approx(1e-6 * plain.change, rel=1e-4)
    assert other.change_half == pytest.approx(1e-6 * plain.change_half, rel=1e-4)
    assert other.p_value == pytest.approx(plain.p_value, rel=1e-3)


def test_odd_series_have_a_finite_trend_or_none():
    few = Series(np.arange(4.0), np.ones(4), np.ones(4), np.full(4, np.nan))
    assert estimate_trend(few, 0.01) is None
    same_time = Series(np.zeros(9), np.ones(9), np.ones(9), np.full(9, np.nan))
    assert estimate_trend(same_time, 0.01) is None
    for value in (np.zeros(9), np.r_[np.zeros(8), 1e90]):
        for std in (np.full(9, 1e-12), np.r_[1e-12, np.ones(8)]):
            trend = estimate_trend(Series(np.r_[np.zeros(4), np.arange(1.0, 6)], value, std, np.full(9, np.nan)), 0.01)
            assert np.isfinite([trend.change, trend.change_half, trend.p_value]).all()
    many = worn_arm(2, 700, {"Fs1": 0.1})
    trend = arm_history("a", many).parameters[0].trend
    assert len(trend.line) == len(trend.corrected) == 700
    assert abs(trend.change - 0.1) < 2.0 * trend.change_half < 0.03


def test_spans_in_words():
    day = 86400.0
    said = {42 * day: "6 weeks", 400 * day: "13 months", 3 * day: "3 days", 5000.0: "83 minutes", 1.0: "1 seconds"}
    assert {span: span_text(span) for span in said} == said
