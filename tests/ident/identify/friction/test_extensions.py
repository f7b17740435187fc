"""Pre-sliding travels: found where there are some, and part of fit, errors, stored result and prediction."""

from __future__ import annotations

import numpy as np
import pytest

from daq.recording.recording import JOINTS_STREAM
from drivers.core.errors import ResultFileError
from ident.identify.friction.extensions import low_speed_error
from ident.identify.identification import IdentifyChoices
from ident.identify.identify import identify
from ident.identify.predict import predict_recording
from ident.identify.revalidate import revalidate
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.presliding import dry_friction
from ident.model.true_parameters import truth_vector
from ident.result.models.model import Model
from ident.result.result_file import result_json
from ident.result.schema import Result
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.synthetic.data_mistakes import with_values

pytestmark = pytest.mark.usefixtures("estimates_alone")

TRAVELS = {"Fs1": 1e-3, "Fs2": 4e-3}
"""Presliding travels of the true arm [rad]; the third joint has none."""


@pytest.fixture(scope="module")
def recordings(three_joint):
    """Two motions of an arm whose friction changes sign over a travel."""
    model = build_model(three_joint)
    base = base_parameters(model)
    dry = dry_friction(model, base, base.projection @ truth_vector(three_joint))
    gains = np.array([three_joint.robot.drive(name).gain for name in model.joint_names])
    made = []
    for seed in (1, 2):
        motion = random_fourier_motion(model, 10.0, seed)
        recording = simulate_recording(three_joint, motion, 20.0, seed)
        stream = recording.streams[JOINTS_STREAM]
        position, velocity, _ = motion.evaluate(stream.time - stream.time[0])
        rate = (len(stream.time) - 1) / (stream.time[-1] - stream.time[0])
        change = dry.torque_change(TRAVELS, position, velocity, rate)
        current = stream.channels["current"].values
        made.append((recording, with_values(recording, current=current + change.T / gains)))
    return made


@pytest.fixture(scope="module")
def found(recordings):
    (_, run), (_, other) = recordings
    return identify([run], [other], IdentifyChoices(reversals=0.2))


@pytest.fixture(scope="module")
def result(found):
    return Result.model_validate_json(result_json(found.result))


def test_true_travels_are_found_and_lower_the_held_out_error(found):
    travels = {one.parameter: one for one in found.presliding.travels}
    for name, truth in TRAVELS.items():
        assert travels[name].travel == pytest.approx(truth, rel=0.1)
        assert 0.0 < travels[name].std < 0.1 * truth
    assert found.presliding.error < 0.2 * found.presliding.static_error


def test_friction_that_changes_at_once_has_no_travel(recordings):
    (run, _), (other, _) = recordings
    presliding = identify([run], [other], IdentifyChoices()).presliding
    assert all(one.travel < 2e-4 for one in presliding.travels)
    assert presliding.error < 1.05 * presliding.static_error


def test_the_travel_is_in_the_fit_and_its_errors(found, recordings):
    (_, run), (_, other) = recordings
    static = identify([run], [other], IdentifyChoices(presliding=False, reversals=0.2))
    assert static.presliding is None
    assert low_speed_error(found.validation_series) == found.presliding.error
    assert found.validation.relative_error < static.validation.relative_error
    assert found.consistent.validation.relative_error < static.consistent.validation.relative_error


def test_a_stored_result_repeats_the_errors(result, found, recordings):
    other = recordings[1][1]
    assert result.presliding.by_parameter == {one.parameter: one.travel for one in found.presliding.travels}
    assert any(step.name == "presliding" and "Fs1" in step.text for step in result.preprocessing)
    again = revalidate(result, other)
    assert low_speed_error(again.series) == pytest.approx(found.presliding.error, rel=1e-9)
    assert again.full.relative_error == pytest.approx(result.validation.relative_error, rel=1e-9)
    assert again.consistent.relative_error == pytest.approx(result.consistent.validation.relative_error, rel=1e-9)
    static = revalidate(result.model_copy(update={"presliding": None}), other)
    assert low_speed_error(static.series) == pytest.approx(found.presliding.static_error, rel=1e-9)


def test_prediction_adds_the_change_to_the_friction(result, recordings, three_joint):
    other, model = recordings[1][1], Model(result, "full")
    (static,) = predict_recording(
        Model(result.model_copy(update={"presliding": None}), "full"), three_joint, other
    ).segments
    (sliding,) = predict_recording(model, three_joint, other).segments
    assert np.allclose(sliding.torque - sliding.parts["friction"], static.torque - static.parts["friction"])
    change = sliding.torque - static.torque
    assert np.max(np.abs(change[:, 0])) > 5.0  # twice Coulomb friction, right after a reversal
    away = model.presliding_torque(static.position, static.velocity, static.rate)
    assert np.allclose(away[200:], change[200:], atol=1e-6)  # the state forgets where it began
    assert np.std(sliding.residual) < np.std(static.residual)


def test_travels_of_another_model_are_refused(result):
    travels = [one.model_copy(update={"parameter": "Fs9"}) for one in result.presliding.travels]
    other = result.model_copy(update={"presliding": result.presliding.model_copy(update={"travels": travels})})
    with pytest.raises(ResultFileError, match="no Coulomb parameter"):
        Model(other)
