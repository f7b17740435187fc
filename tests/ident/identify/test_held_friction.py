"""Identification with a friction experiment: its terms and shapes, temperature terms held where nothing tells them."""

from __future__ import annotations

import json

import numpy as np
import pytest
from command_line import stored
from friction_experiment_arm import arm, experiment

from daq.recording.recording import Recording
from drivers.core.errors import DataError, UsageError
from ident.model.true_parameters import true_model
from ident.result.models.load_model import load_model
from ident.tasks.identification import identify
from ident.tasks.validation import validate
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.synthetic.data_mistakes import with_values

pytestmark = pytest.mark.usefixtures("estimates_alone", "stated_friction")

DURATION = 12.0


def exciting(seed: int, least: float, greatest: float) -> Recording:
    """A motion of both joints at temperatures [°C] that rise."""
    told = arm(told=True)
    heat = np.linspace(least, greatest, round(DURATION * 100))[:, None] * [1.0, 0.95]
    one = simulate_recording(
        told, random_fourier_motion(true_model(arm()), DURATION, seed), DURATION, seed, celsius=heat
    )
    return Recording(arm().text, one.streams)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("friction")
    experiment().save(path)
    return path


@pytest.fixture(scope="module")
def held(folder):
    return identify(exciting(1, 30.0, 31.0), validation=exciting(2, 38.0, 39.0), friction_from=folder, delay=0.0)


def test_the_model_predicts_at_another_temperature(held):
    plain = identify(
        exciting(1, 30.0, 31.0), validation=exciting(2, 38.0, 39.0), friction="coulomb-viscous+power+load", delay=0.0
    )
    assert held.validation.relative_error < 0.2 * plain.validation.relative_error
    assert held.validation.relative_error < 1.5 * held.fit.relative_error


def test_held_values_show_their_origin_and_error(held, folder):
    stored = json.loads((folder / "friction.json").read_text(encoding="utf-8"))
    entries = {entry.name: entry for entry in held.result.base_parameters}
    names = ("Ft1", "Fts1", "Ft2", "Fts2")
    assert {name for name, entry in entries.items() if entry.origin} == set(names)
    first = stored["joints"][0]
    place = first["kinds"].index("temperature_slope")
    assert entries["Fts1"].value == first["values"][place]
    assert entries["Fts1"].std == pytest.approx(np.sqrt(first["covariance"][place][place]))
    assert entries["Fs1"].origin == ""
    assert held.result.friction[0].temperature == pytest.approx(first["temperature"])
    assert "held, friction experiment" in held.result.friction[0].terms_text
    assert any("held at the friction experiment's values" in step.text for step in held.result.preprocessing)


def test_storage_and_validation_agree(held, tmp_path):
    held.save(tmp_path)
    for kind in ("full", "consistent", "essential"):
        model = load_model(tmp_path, parameters=kind)
        again = validate(model, exciting(2, 38.0, 39.0))
        assert again.full.relative_error == pytest.approx(held.validation.relative_error, rel=0.02)
        q, dq, ddq, heat = [0.4, 0.3], [0.5, -0.4], [0.1, 0.2], [30.0, 35.0]
        assert np.all(model.torque_std(q, dq, ddq, heat) > 0.0)
        parts = model.mass_matrix(q) @ ddq + model.gravity(q) + model.coriolis(q, dq) + model.friction(dq, q, heat)
        assert np.allclose(parts, model.torque(q, dq, ddq, heat))


@pytest.mark.usefixtures("with_checks")
@pytest.mark.parametrize("factors", [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0)])
def test_a_torque_of_the_wrong_sign_is_found_whatever_friction_is_held(folder, factors):
    run = exciting(1, 30.0, 31.0)
    channels = run.streams["joints"].channels
    signals = channels.keys() & {"torque", "current"}
    wrong = with_values(run, **{name: channels[name].values * factors for name in signals})
    checks = identify(wrong, friction_from=folder, delay=0.0).verdict.checks
    names = [check.name for check in checks if check.name in ("torque-sign", "sign-or-column", "joint-sign")]
    assert bool(names) == (-1.0 in factors), checks


def test_temperature_terms_are_estimated_where_the_recording_tells_them(folder):
    found = identify(exciting(1, 22.0, 42.0), friction_from=folder, delay=0.0).result
    assert not any(entry.origin for entry in found.base_parameters)
    truth = arm().robot.truth.joints
    for joint in found.friction:
        errors = np.abs(np.array(joint.temperature[:2]) - truth[joint.joint].temperature[:2])
        assert np.all(errors < 4.5 * np.array(joint.temperature_std[:2]))
        assert joint.exponent_std is None  # the experiment's


def test_what_does_not_belong_together_is_refused(folder, tmp_path):
    run = exciting(1, 30.0, 31.0)
    with pytest.raises(UsageError, match="exclude each other"):
        identify(run, friction="auto", friction_from=folder)
    content = stored(folder / "friction.json")
    for key, value, message in (
        ("robot", "ur5e", "the friction experiment is of ur5e"),
        ("joints", [{**content["joints"][0], "joint": "j3"}], "no joint of arm is called 'j3'"),
    ):
        (tmp_path / "friction.json").write_text(json.dumps({**content, key: value}), encoding="utf-8")
        with pytest.raises(UsageError, match=message):
            identify(run, friction_from=tmp_path)
    stream = run.streams["joints"]
    channels = {name: channel for name, channel in stream.channels.items() if name != "temperature"}
    cold = Recording(run.robot_text, {"joints": type(stream)("joints", stream.time, stream.host_time, channels)})
    with pytest.raises(DataError, match="temperature of j1, j2 is missing"):
        identify(cold, friction_from=folder)
