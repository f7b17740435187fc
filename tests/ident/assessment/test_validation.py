"""Errors of a prediction: exact ones on constructed torques."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.core.errors import DataError
from ident.assessment.validation import LOW_SPEED, fit_errors, overfitting_checks
from ident.model.dynamic_model import build_model
from ident.model.true_parameters import truth_vector
from ident.regression.comparison import TorqueSeries, compare_torques
from ident.signals.filters import butterworth, no_filter


def series(measured, predicted, velocity, used=None) -> TorqueSeries:
    measured, predicted, velocity = (np.asarray(values, dtype=float) for values in (measured, predicted, velocity))
    count = measured.shape[1]
    used = np.ones(count, dtype=bool) if used is None else np.asarray(used, dtype=bool)
    return TorqueSeries(np.arange(count) / 100, measured, predicted, velocity, used)


def test_figures_of_four_samples():
    figures = fit_errors(
        [series([[3, 3, 3, 3], [0, 0, 0, 0]], [[3, 2, 3, 1], [0, 0, 0, 0]], [[0.01, 0.05, -1, -2], [1, 1, 1, 1]])]
    )
    assert figures.relative_error == pytest.approx(np.sqrt(5) / 6)
    assert figures.joint_relative_error == [pytest.approx(np.sqrt(5) / 6), None]
    assert figures.rmse == pytest.approx([np.sqrt(5 / 4), 0])
    assert figures.low_speed_rmse == [pytest.approx(np.sqrt(1 / 2)), None]
    assert figures.high_speed_rmse == pytest.approx([np.sqrt(4 / 2), 0])
    assert figures.max_error == pytest.approx([2, 0])
    assert figures.samples == 4


def test_a_perfect_prediction_has_no_error(three_joint, smooth_segment):
    model = build_model(three_joint)
    truth = truth_vector(three_joint)
    segment = smooth_segment(model, 900, parameters=truth)
    for zero_phase in (no_filter(), butterworth(5.0, 100.0, factor=4)):
        figures = fit_errors(compare_torques(model, range(len(truth)), truth, [segment], zero_phase))
        assert figures.relative_error < 1e-12
        assert max(figures.rmse) < 1e-10
        assert figures.samples == len(segment.time[:: zero_phase.factor])


def test_measured_torque_is_filtered_like_the_prediction(three_joint, smooth_segment):
    """A relative error of filtered torque must not be quoted for raw torque: half a ripple is not half an error."""
    model = build_model(three_joint)
    truth = truth_vector(three_joint)
    segment = smooth_segment(model, 2000, parameters=truth)
    buzz = 5.0 * np.sin(2 * np.pi * 40.0 * segment.time)
    segment = replace(segment, torque=segment.torque + buzz)
    raw = fit_errors(compare_torques(model, range(len(truth)), truth, [segment], no_filter()))
    assert raw.rmse == [pytest.approx(5.0 / np.sqrt(2), rel=0.01)] * 3
    used = np.zeros(2000, dtype=bool)
    used[200:-200] = True
    inner = replace(segment, used=used)
    filtered = fit_errors(compare_torques(model, range(len(truth)), truth, [inner], butterworth(5.0, 100.0)))
    assert max(filtered.rmse) < 1e-2


@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 1000), cut=st.integers(1, 99))
def test_speeds_split_the_squares_and_stretches_join_them(seed, cut):
    generator = np.random.default_rng(seed)
    measured, predicted, velocity = generator.standard_normal((3, 2, 100))
    velocity *= 2 * LOW_SPEED
    used = generator.random(100) < 0.8
    used[0] = used[-1] = True
    whole = series(measured, predicted, velocity, used)
    figures = fit_errors([whole])
    parts = [
        series(measured[:, part], predicted[:, part], velocity[:, part], used[part])
        for part in (slice(0, cut), slice(cut, 100))
    ]
    joined = fit_errors(parts)
    assert joined.relative_error == pytest.approx(figures.relative_error)
    assert joined.rmse == pytest.approx(figures.rmse)
    assert joined.max_error == pytest.approx(figures.max_error)
    slow = np.sum((np.abs(velocity) < LOW_SPEED) & used, axis=1)
    low, high, rmse = (
        np.nan_to_num(np.array(errors, dtype=float))
        for errors in (figures.low_speed_rmse, figures.high_speed_rmse, figures.rmse)
    )
    assert (low**2 * slow + high**2 * (used.sum() - slow)) / used.sum() == pytest.approx(rmse**2)


def test_unused_samples_do_not_count():
    figures = fit_errors([series([[1, 1, 1]], [[1, 99, 1]], [[1, 1, 1]], [True, False, True])])
    assert figures.relative_error == 0.0
    assert figures.samples == 2
    assert np.array_equal(series([[1, 1]], [[0, 5]], [[1, 1]], [True, False]).residual, [[1, 0]])


def test_speed_is_judged_joint_by_joint():
    figures = fit_errors([series([[1, 1], [1, 1]], [[0, 1], [1, 0]], [[0, 1], [1, 0]])])
    assert figures.low_speed_rmse == pytest.approx([1, 1])
    assert figures.high_speed_rmse == pytest.approx([0, 0])


def test_nothing_that_counts_is_an_error_in_words():
    with pytest.raises(DataError, match="does not move"):
        fit_errors([series([[1, 1]], [[1, 1]], [[0, 0]], [False, False])])


def test_a_resting_joint_s_torque_is_not_compared():
    torques = series([[3, 3, 9], [1, 1, 1]], [[3, 2, 0], [1, 1, 1]], [[1, 1, 0], [1, 1, 1]])
    resting = replace(torques, resting=np.array([[False, False, True], [False, False, False]]))
    figures = fit_errors([resting])
    assert figures.rmse == pytest.approx([np.sqrt(1 / 2), 0])
    assert figures.max_error == pytest.approx([1, 0])
    assert figures.relative_error == pytest.approx(1 / np.sqrt(18 + 3))
    assert np.array_equal(resting.residual, [[0, 1, 0], [0, 0, 0]])
    throughout = fit_errors([replace(torques, resting=np.array([[True] * 3, [False] * 3]))])
    assert [throughout.rmse[0], throughout.max_error[0], throughout.joint_relative_error[0]] == [None] * 3
    assert throughout.relative_error == 0.0
    with pytest.raises(DataError, match="does not move"):
        fit_errors([replace(torques, resting=np.ones((2, 3), dtype=bool))])


@given(size=st.floats(0.1, 100.0))
def test_a_motion_of_other_torque_is_no_overfitting(size):
    """The same errors in N·m, or the same shares of the torque: one of the two figures is larger, and no check."""
    error, velocity = np.array([[0.1, -0.1, 0.1, -0.1]]), [[1.0, 1.0, 0.05, 0.05]]
    fitted = fit_errors([series([[10.0] * 4], 10.0 + error, velocity)])
    for errors in (error, size / 10.0 * error):
        held_out = fit_errors([series([[size] * 4], size + errors, velocity)])
        assert overfitting_checks(fitted, held_out) == []


@pytest.mark.parametrize(
    ("error", "name"), [([0.3, -0.3, 0.3, -0.3], "overfitting"), ([0.1, -0.1, 0.9, -0.9], "errors-near-standstill")]
)
def test_larger_errors_are_told_by_their_cause(error, name):
    velocity = [[1.0, 1.0, 0.05, 0.05]]
    fitted = fit_errors([series([[5.0] * 4], np.add([[5.0] * 4], [[0.1, -0.1, 0.1, -0.1]]), velocity)])
    held_out = fit_errors([series([[5.0] * 4], np.add([[5.0] * 4], [error]), velocity)])
    (check,) = overfitting_checks(fitted, held_out)
    assert check.name == name
    assert f"{held_out.rmse[0] / fitted.rmse[0]:.1f} times" in check.text
