"""Least squares on Kalman-filtered torques: the filter of ROCR6, and that it says what least squares says."""

from __future__ import annotations

import numpy as np
import pytest
from each import each
from filterpy.kalman import KalmanFilter

from drivers.core.errors import UsageError
from ident.estimators.method_choice import chosen_method
from ident.estimators.methods.kalman_wls import filtered_torque, stationary_gain
from ident.identify.identification import IdentifyChoices
from ident.identify.identify import identify
from ident.model.dynamic_model import build_model
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording

pytestmark = pytest.mark.usefixtures("estimates_alone", "stated_friction")


@each("ratio", [1e-3, 0.1, 10.0])
def test_it_is_filterpys_filter_with_the_models_change_as_input(ratio):
    generator = np.random.default_rng(0)
    modelled = 5.0 * np.sin(np.linspace(0.0, 9.0, 400))
    measured = modelled + 0.3 * generator.standard_normal(400) + 0.2
    kalman = KalmanFilter(1, 1, 1)
    kalman.F = kalman.H = kalman.B = np.eye(1)
    kalman.Q, kalman.R = np.array([[ratio * 0.04]]), np.array([[0.04]])
    kalman.x = measured[:1, None].copy()
    settled = 0.5 * (ratio + np.sqrt(ratio**2 + 4.0 * ratio)) * 0.04
    kalman.P = np.array([[settled - kalman.Q[0, 0]]])
    expected = [measured[0]]
    for sample in range(1, 400):
        kalman.predict(u=np.array([[modelled[sample] - modelled[sample - 1]]]))
        kalman.update(measured[sample])
        expected.append(kalman.x[0, 0])
    assert kalman.K[0, 0] == pytest.approx(stationary_gain(ratio))
    found = filtered_torque(measured[None], modelled[None], ratio)[0]
    assert found == pytest.approx(np.array(expected), abs=1e-10)


def test_no_filter_at_a_large_ratio_and_the_model_at_a_small_one():
    measured, modelled = np.random.default_rng(1).standard_normal((2, 3, 50))
    measured[:, 0] = modelled[:, 0]
    assert filtered_torque(measured, modelled, 1e10) == pytest.approx(measured, abs=1e-8)
    assert filtered_torque(measured, modelled, 1e-12) == pytest.approx(modelled, abs=1e-3)


def test_it_stays_at_least_squares(three_joint):
    recording = simulate_recording(
        three_joint, random_fourier_motion(build_model(three_joint), 8.0, seed=1), 16.0, seed=1
    )
    plain, filtered, measured = (
        identify([recording], [], IdentifyChoices(method, search_delay=False))
        for method in ("wls", "kalman-wls", "kalman-wls:ratio=1e10")
    )
    assert measured.solution.parameters == pytest.approx(plain.solution.parameters, abs=1e-7)  # nothing is filtered
    assert filtered.solution.method == "kalman-wls"
    difference = (filtered.solution.parameters - plain.solution.parameters) / plain.std
    assert 0.0 < np.max(np.abs(difference)) < 1.0
    assert filtered.std == pytest.approx(plain.std, rel=0.3)


@pytest.mark.parametrize("text", ["kalman-wls:ratio=0", "kalman-wls:rounds=0"])
def test_bad_settings_are_refused(text):
    with pytest.raises(UsageError):
        chosen_method(text)
