"""Predicted torque of a recording: its parts, its standard deviation, and what remains."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import dynid
from studies.synthetic.data_mistakes import with_values


@pytest.fixture(scope="module")
def prediction(result, other):
    return dynid.predict(result, other)


def with_torque(run: dynid.Recording, extra: np.ndarray | None, keep: slice = slice(None)) -> dynid.Recording:
    """The recording with a torque added to its motors, or without currents where None; some samples only."""
    joints = run.streams["joints"]
    channels = {
        quantity: replace(channel, values=channel.values[keep]) for quantity, channel in joints.channels.items()
    }
    current = channels.pop("current")
    if extra is not None:
        robot = run.robot().robot
        gains = np.array([robot.drive(name).gain for name in robot.joint_names])
        channels["current"] = replace(current, values=current.values + extra / gains)
    changed = replace(joints, time=joints.time[keep], host_time=joints.host_time[keep], channels=channels)
    return replace(run, streams={**run.streams, "joints": changed})


def test_the_parts_are_those_of_the_model_and_add_up(prediction, result):
    model, p = result.model, prediction
    np.testing.assert_allclose(p.torque, model.torque(p.position, p.velocity, p.acceleration), atol=1e-9)
    np.testing.assert_allclose(p.gravity, model.gravity(p.position), atol=1e-12)
    np.testing.assert_allclose(p.friction, model.friction(p.velocity), atol=1e-12)
    np.testing.assert_allclose(p.coriolis, model.coriolis(p.position, p.velocity), atol=1e-12)
    inertial = np.einsum("Nij,Nj->Ni", model.mass_matrix(p.position), p.acceleration)
    np.testing.assert_allclose(p.inertial, inertial, atol=1e-8)
    np.testing.assert_allclose(p.inertial + p.coriolis + p.gravity + p.friction, p.torque, atol=1e-10)
    np.testing.assert_array_equal(p.std, model.torque_std(p.position, p.velocity, p.acceleration))


def test_the_residual_is_as_large_as_validation_says_and_within_its_deviation(prediction, result, other):
    validated = dynid.validate(result, other)
    rmse = np.sqrt(np.mean(prediction.residual**2, axis=0))
    np.testing.assert_allclose(rmse, validated.full.rmse, rtol=0.25)
    normalised = prediction.residual / prediction.residual_std
    assert 0.7 < np.mean(np.abs(normalised) < 1.96) <= 1.0
    assert np.all(prediction.residual_std >= prediction.std)


def test_data_of_the_identification_are_said_not_to_be_held_out(prediction, result, run):
    assert "NOT held out" in dynid.predict(result, run).summary.title
    assert "held out" not in prediction.summary.title


def test_an_external_torque_appears_in_the_residual_with_the_sign_that_is_written(prediction, result, other):
    time = other.streams["joints"].time - other.streams["joints"].time[0]
    extra = np.zeros((len(time), 6))
    extra[(time > 4.0) & (time < 7.0), 1] = 8.0  # the motor pushes against something for 3 s
    pushed = dynid.predict(result, with_torque(other, extra))
    change = pushed.residual - prediction.residual
    inside = (pushed.time > pushed.time[0] + 4.7) & (pushed.time < pushed.time[0] + 5.5)
    np.testing.assert_allclose(change[inside, 1], 8.0, atol=0.4)
    np.testing.assert_allclose(change[:, [0, 2, 3, 4, 5]], 0.0, atol=1e-9)
    np.testing.assert_array_equal(pushed.torque, prediction.torque)


def test_the_torque_of_a_planned_motion_is_that_along_its_trajectory(result, tmp_path):
    path = tmp_path / "motion.yaml"
    path.write_text(
        "robot: ur5e\nkind: points\npoints: [[0, -1.2, 1, -1, -1, 0], [0.5, -0.8, 0.4, -2, 0, 1]]\ndurations: [4.02]\n"
    )
    planned = dynid.predict(result, path)
    position, velocity, acceleration = dynid.load_trajectory(path, "ur5e").evaluate(planned.time)
    exact = result.model.torque(position, velocity, acceleration)
    moving = np.abs(velocity).min(axis=1) > 0.01  # at rest the sign of the velocity is rounding
    np.testing.assert_allclose(planned.torque[moving], exact[moving], atol=0.01 * np.abs(exact).max())
    assert planned.time[0] + planned.time[-1] == pytest.approx(4.02)  # the filter takes as much from both ends
    assert planned.residual is None
    assert "motion.yaml" in planned.summary.title


def test_it_is_a_recording_that_can_be_read_back(prediction, result, tmp_path):
    prediction.save(tmp_path / "out.h5")
    with pytest.raises(dynid.UsageError, match="exists already"):
        prediction.save(tmp_path / "out.h5")
    read = dynid.read_recording(tmp_path / "out.h5")
    assert read.robot().robot == prediction.robot_file.robot
    stream = read.streams["prediction"]
    np.testing.assert_array_equal(stream.time, prediction.time)
    expected = {
        "predicted_torque": prediction.torque,
        "inertial_torque": prediction.inertial,
        "coriolis_torque": prediction.coriolis,
        "gravity_torque": prediction.gravity,
        "friction_torque": prediction.friction,
        "predicted_torque_std": prediction.std,
        "residual_torque": prediction.residual,
        "residual_torque_std": prediction.residual_std,
    }
    assert set(stream.channels) == set(expected)
    for quantity, values in expected.items():
        channel = stream.channels[quantity]
        np.testing.assert_array_equal(channel.values, values)
        assert channel.unit == "N*m"
        assert channel.description
    np.testing.assert_array_equal(read.streams["joints"].channels["torque"].values, prediction.measured)
    assert any("consistent parameters of ur5e" in event.message for event in read.events)


def test_a_recording_without_torque_is_predicted_without_a_residual(prediction, result, other, tmp_path):
    silent = dynid.predict(result, with_torque(other, None))
    assert silent.measured is None
    assert silent.residual is None
    assert silent.residual_std is None
    assert silent.summary.row("elbow_joint")["measured"] is None
    np.testing.assert_allclose(silent.torque.std(axis=0), prediction.torque.std(axis=0), rtol=0.1)
    silent.page(tmp_path / "page.html")
    silent.save(tmp_path / "out.h5")
    assert "torque" not in dynid.read_recording(tmp_path / "out.h5").streams["joints"].channels


def test_an_arm_at_rest_is_predicted_too(result, other):
    position = other.streams["joints"].channels["position"].values
    predicted = dynid.predict(result, with_values(other, position=np.repeat(position[:1], len(position), axis=0)))
    held = np.broadcast_to(predicted.gravity[0], predicted.gravity.shape)
    np.testing.assert_allclose(predicted.gravity, held, rtol=0, atol=1e-9)
    np.testing.assert_allclose(predicted.inertial, 0.0, atol=1e-6)


def test_gaps_separate_segments(result, other):
    count = len(other.streams["joints"].time)
    keep = np.r_[0 : count // 2, count // 2 + 50 : count]
    predicted = dynid.predict(result, with_torque(other, np.zeros(6), keep))
    assert len(predicted.segments.segments) == 2
    assert len(predicted.time) == sum(len(part.time) for part in predicted.segments.segments)
    assert np.diff(predicted.time).max() > 0.4


def test_a_model_or_a_folder_predicts_the_same(prediction, result, other, tmp_path):
    result.save(tmp_path / "model")
    np.testing.assert_allclose(dynid.predict(tmp_path / "model", other).torque, prediction.torque, atol=1e-9)
    essential = dynid.Model(result.result, "essential")
    by_model = dynid.predict(essential, other)
    by_name = dynid.predict(result, other, parameters="essential")
    np.testing.assert_array_equal(by_model.torque, by_name.torque)
    assert np.any(by_model.torque != prediction.torque)


def test_the_page_and_the_tables_show_the_joints(prediction, tmp_path):
    from html_page import Page

    prediction.page(tmp_path / "page.html")
    page = Page((tmp_path / "page.html").read_text(encoding="utf-8"))
    assert set(page.figures) == {"torque-plot", "residual-plot", "parts-plot"}
    assert "wrist_3_joint" in page.words
    assert "wrist_3_joint" in str(prediction)
    assert "wrist_3_joint" in prediction._repr_html_()
    with pytest.raises(dynid.UsageError, match=r"exists already .*overwrite=True"):
        prediction.page(tmp_path / "page.html")
    prediction.page(tmp_path / "page.html", overwrite=True)
    with pytest.raises(dynid.UsageError, match="there is no such folder"):
        prediction.page(tmp_path / "nowhere" / "page.html")


@pytest.mark.usefixtures("estimate_alone")
def test_torques_of_coupled_motors_are_the_joints():
    run, other = (dynid.simulate("rocr6", duration=10.0, seed=seed, rate=100.0) for seed in (1, 2))
    arm = dynid.simulate("sr400", duration=8.0, seed=3, rate=100.0)
    for training, held_out in ((run, other), (arm, dynid.simulate("sr400", duration=4.0, seed=4, rate=100.0))):
        model = dynid.identify(training, friction="coulomb-viscous", presliding=False)
        predicted = dynid.predict(model, held_out)
        error = np.linalg.norm(predicted.residual) / np.linalg.norm(predicted.measured)
        assert error < 0.1


def test_another_arm_is_refused(result):
    with pytest.raises(dynid.DataError, match="is of up6 with joints"):
        dynid.predict(result, dynid.simulate("up6", duration=3.0, seed=1))
