"""A stored result predicts what the identification predicted."""

from __future__ import annotations

import json

import numpy as np
import pytest
from pydantic import ValidationError

from drivers.core.errors import DataError, ResultFileError
from ident.identify.identification import IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.identify.revalidate import revalidate
from ident.model.dynamic_model import build_model
from ident.result.result_file import read_result, result_json
from ident.signals.pipeline import PreprocessChoices
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording

pytestmark = pytest.mark.usefixtures("estimates_alone", "stated_friction")


@pytest.fixture(scope="module")
def recordings(three_joint):
    model = build_model(three_joint)
    return [
        simulate_recording(three_joint, random_fourier_motion(model, 10.0, seed), seconds, seed)
        for seed, seconds in ((1, 14.0), (2, 9.0))
    ]


CHOICES = {
    "default": IdentifyChoices(),
    "ols, other columns": IdentifyChoices(
        method="ols", model=ModelChoices(friction="coulomb", offset=False, motor_inertia=False, smoothing=0.1)
    ),
    "chebyshev": IdentifyChoices(preprocess=PreprocessChoices(filter="chebyshev", position_decimate=2)),
    "kalman": IdentifyChoices(preprocess=PreprocessChoices(differentiation="kalman")),
    "given": IdentifyChoices(
        preprocess=PreprocessChoices(
            position_cutoff=15.0, torque_cutoff=6.0, decimate=7, delay=2e-3, start=1.0, stop=13.0
        ),
        search_delay=False,
    ),
}


@pytest.mark.parametrize("name", CHOICES)
def test_a_stored_result_repeats_the_validation(recordings, name, tmp_path):
    found = identify(recordings[:1], recordings[1:], CHOICES[name])
    (tmp_path / "result.json").write_text(result_json(found.result))
    again = revalidate(read_result(tmp_path / "result.json"), recordings[1])
    assert again.full.samples == found.validation.samples
    assert again.full.relative_error == pytest.approx(found.validation.relative_error, rel=1e-9)
    assert np.allclose(again.full.rmse, found.validation.rmse, rtol=1e-9)
    assert again.essential.relative_error == pytest.approx(found.essential.validation.relative_error, rel=1e-9)
    assert len(again.series) == len(found.validation_series)


@pytest.fixture(scope="module")
def result(recordings):
    found = identify(recordings[:1], recordings[1:], IdentifyChoices())
    return found.result


def tampered(result, change):
    content = json.loads(result_json(result))
    change(content)
    return type(result).model_validate(content)


def test_a_wrong_parameter_shows(result, recordings):
    def change(content):
        parameter = next(p for p in content["base_parameters"] if p["name"] == "MXR2")
        parameter["value"] *= -1

    worse = revalidate(tampered(result, change), recordings[1])
    assert worse.full.relative_error > 10 * revalidate(result, recordings[1]).full.relative_error


@pytest.mark.parametrize(
    "change",
    [
        lambda content: content["base_parameters"].pop(),
        lambda content: content["base_parameters"][0].update(name="XX9"),
        lambda content: content["model_options"].update(offset=[False, True, True]),
        lambda content: content.update(robot_file=content["robot_file"].replace("{joint: j2,", "{joint: j4,")),
    ],
    ids=["one missing", "renamed", "other columns", "another arm"],
)
def test_parameters_that_do_not_belong_to_the_robot_are_refused(result, recordings, change):
    from drivers.core.errors import RobotFileError

    with pytest.raises((ResultFileError, RobotFileError)):
        revalidate(tampered(result, change), recordings[1])


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("torque_cutoff", "high"),
        ("decimate", 2.5),
        ("filter", "box"),
        ("differentiation", "spline"),
        ("keep_rest", "perhaps"),
    ],
)
def test_options_of_the_wrong_type_are_named(result, recordings, key, value):
    with pytest.raises(ResultFileError, match=rf"options\.{key}"):
        revalidate(tampered(result, lambda content: content["options"].update({key: value})), recordings[1])


def test_flags_for_another_number_of_joints_are_refused(result):
    with pytest.raises(ValidationError, match="'viscous' has 1 entries for 3 joints"):
        tampered(result, lambda content: content["model_options"].update(viscous=[True]))


def test_a_recording_of_another_arm_is_refused(result):
    from daq.robot.loader import load_robot

    other = load_robot("ur5e")
    recording = simulate_recording(other, random_fourier_motion(build_model(other), 10.0, 1), 3.0, 1)
    with pytest.raises(DataError, match="is of ur5e with joints"):
        revalidate(result, recording)
