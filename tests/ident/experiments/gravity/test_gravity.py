"""Gravity from poses passed in both directions: what is found, with which error, and what is refused by name."""

import subprocess
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import dynid
from daq.recording.recording import JOINTS_STREAM
from daq.robot.loader import parse_robot
from drivers.core.errors import DataError, IdentificationError, ModelError, ResultFileError, UsageError
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.model.true_parameters import truth_vector
from sim_drivers.synthetic.measurement import simulate_recording

NOISE = 2.0
"""[N·m] of each torque sample; the UP6's gravity is up to some 1000 N·m."""


@cache
def _motion():
    return dynid.design_gravity_motion("up6", poses=10)


@cache
def _clean():
    trajectory, _ = _motion()
    run = simulate_recording(trajectory.robot_file, trajectory.motion, trajectory.duration, seed=1, rate=100.0)
    return replace(run, trajectory=trajectory.text)


def _changed(torque=None, position=None, part=slice(None), seed=0, **more):
    """The recording with noise, its torques and positions (N, 3) changed by functions, or a part of it alone."""
    run = _clean()
    stream = run.streams[JOINTS_STREAM]
    time, channels = stream.time[part], {}
    for name, channel in stream.channels.items():
        values = channel.values[part].copy()
        if name == "torque":
            values += NOISE * np.random.default_rng(seed).standard_normal(values.shape)
        change = {"torque": torque, "position": position}[name]
        channels[name] = replace(channel, values=values if change is None else change(values, time))
    streams = {JOINTS_STREAM: replace(stream, time=time, host_time=time, channels=channels)}
    return replace(run, streams=streams, **more)


@cache
def _identified():
    return dynid.identify_gravity(_changed())


def _true_gravity(q, robot_file):
    model = build_model(robot_file)
    base = base_parameters(model)
    standard = truth_vector(robot_file, model)
    return InverseDynamics(model, base, base.projection @ standard, standard).gravity(np.asarray(q).T).T


def _poses(count=50):
    limits = np.array([joint.position for joint in _motion()[0].robot_file.robot.joints])
    return np.random.default_rng(3).uniform(limits[:, 0], limits[:, 1], (count, len(limits)))


def test_the_true_gravity_is_found_within_its_error_bars():
    found, q = _identified(), _poses()
    error = found.model.gravity(q) - _true_gravity(q, _motion()[0].robot_file)
    size = np.sqrt(np.mean(_true_gravity(q, _motion()[0].robot_file) ** 2))
    assert np.sqrt(np.mean(error**2)) < 2e-3 * size
    offset = {one.joint: one for one in found.result.gravity_parameters if one.kind == "offset"}
    truth = _motion()[0].robot_file.robot.truth.joints
    friction = [truth[name].coulomb + 0.1 * truth[name].viscous for name in found.result.joints]
    for one, expected in zip(found.result.of_joints, friction, strict=True):
        assert one.friction == pytest.approx(expected, rel=0.15)
    assert all(one.low < truth[name].offset < one.high or abs(one.value) < 2.0 for name, one in offset.items())
    assert found.result.silent == ["S"]
    shown = {trace.name: trace.y for trace in found.plot().data[:2]}
    np.testing.assert_allclose(shown["measured"], shown["predicted"], atol=5 * NOISE)
    assert len(found.plot(backend="matplotlib").axes) == len(found.result.joints)
    assert found.verdict.startswith("Good for gravity compensation")
    assert (found.model.torque_std(q) > 0.0).all()


def test_friction_does_not_matter_however_large_it_is():
    direction = np.sign(np.gradient(_clean().position, axis=0))
    rubbed = dynid.identify_gravity(_changed(torque=lambda torque, time: torque + 200.0 * direction))
    q = _poses()
    np.testing.assert_allclose(rubbed.model.gravity(q), _identified().model.gravity(q), atol=1.0)
    for one, before in zip(rubbed.result.of_joints, _identified().result.of_joints, strict=True):
        assert one.friction == pytest.approx(before.friction + 200.0, abs=3.0)


def test_a_saved_model_is_loaded_validated_and_exported(tmp_path):
    _identified().save(tmp_path)
    model, q = dynid.load_model(tmp_path), _poses(5)
    assert isinstance(model, dynid.GravityModel)
    np.testing.assert_allclose(model.gravity(q), _identified().model.gravity(q))
    offsets = model.torque(q) - model.gravity(q)
    np.testing.assert_allclose(offsets, np.broadcast_to(offsets[0], offsets.shape), atol=1e-9)
    np.testing.assert_allclose(model.regressor(q) @ model._values, model.torque(q), atol=1e-6)
    judged = _identified().validate(_changed(seed=7))
    assert judged.result.validation.held_out
    assert max(judged.result.validation.rms) < 2.0
    assert not _identified().validate(_changed()).result.validation.held_out
    export = model.export_c(tmp_path / "arm")
    command = ["cc", "-std=c99", "-DUP6_SELF_TEST", str(export.path), "-o", str(tmp_path / "arm"), "-lm"]
    subprocess.run(command, check=True, timeout=60)
    assert "up6_gravity(" in export.path.read_text()
    assert subprocess.run([str(tmp_path / "arm")], timeout=60, check=False).returncode == 0
    page = (tmp_path / "report.html").read_text()
    assert "Good for gravity compensation" in page
    assert "MXR2" in page


def test_what_a_model_of_gravity_cannot_do_is_said(tmp_path):
    model = _identified().model
    _identified().save(tmp_path)
    q = [0.0] * 3
    for call in (
        lambda: model.mass_matrix(q),
        lambda: model.forward_dynamics(q, q, q),
        lambda: model.coriolis(q, q),
        lambda: model.friction(q),
        lambda: model.torque(q, [1.0, 0.0, 0.0]),
        lambda: model.torque_parts(q, [0.0, 1.0, 0.0]),
        lambda: model.simulate(q, q, None, 1.0),
        lambda: model.export_urdf(tmp_path / "arm.urdf"),
        lambda: model.export_mjcf(tmp_path / "arm.xml"),
        lambda: model.to_pinocchio(),
        lambda: dynid.predict(model, _changed()),
        lambda: dynid.predict(tmp_path, _changed()),
        lambda: dynid.validate(model, _changed()),
        lambda: dynid.merge([model, model]),
    ):
        with pytest.raises(ModelError, match="a model of gravity, without"):
            raise AssertionError(call())
    for call in (lambda: dynid.validate(tmp_path, _changed()), lambda: dynid.load_result(tmp_path)):
        with pytest.raises(ResultFileError, match="model of gravity"):
            raise AssertionError(call())
    with pytest.raises(UsageError, match="one set of parameters"):
        dynid.load_model(tmp_path, parameters="full")


def test_recordings_without_both_directions_are_refused_by_joint_and_pose():
    with pytest.raises(DataError, match="no pose that is passed slowly"):
        dynid.identify_gravity(dynid.simulate("up6", duration=10.0, rate=100.0))
    ends = _one_way()
    with pytest.raises(DataError, match=r"passes S at .* rad (up|down)wards, .* in one direction only, and so at"):
        dynid.identify_gravity(_changed(part=ends))
    with pytest.raises(IdentificationError, match="only 2 different poses"):
        dynid.identify_gravity(_changed(part=slice(0, int(0.2 * len(_clean().time)))))


def _one_way():
    """Samples without every second pass, as of an arm that is carried back with another recording."""
    trajectory, designed = _motion()
    motion = trajectory.motion
    begin = np.cumsum(np.concatenate([[0.0], motion.durations + motion.dwell]))
    slow = np.flatnonzero(np.abs(motion.durations - designed.pass_time) < 1e-9)
    backward = [index for index in slow if index - 1 in slow and (index - slow[0]) and index + 1 not in slow]
    time = _clean().time
    kept = np.ones(len(time), dtype=bool)
    for index in backward:
        kept &= (time < begin[index]) | (time > begin[index + 1])
    return kept


def test_a_recording_cut_short_still_counts():
    found = dynid.identify_gravity(_changed(part=slice(0, int(0.62 * len(_clean().time)))))
    assert len(found.result.poses) < 8
    assert not found.verdict.startswith("Good")
    q = _poses()
    assert np.abs(found.model.gravity(q) - _identified().model.gravity(q)).max() < 30.0


def test_mistakes_are_named():
    half = _clean().time[-1] / 2
    cases = (
        ("torque of L or U fits the others with the opposite sign", {"torque": lambda tau, t: tau * [1.0, 1.0, -1.0]}),
        ("opposite to what the robot file's masses need", {"torque": lambda tau, t: -tau}),
        ("U was commanded to move, and its position never", {"position": lambda q, t: q * [1, 1, 0] + [0, 0, 0.5]}),
        ("a load was picked up", {"torque": lambda tau, t: tau + np.where(t > half, 300.0, 0.0)[:, None]}),
    )
    for words, change in cases:
        found = dynid.identify_gravity(_changed(**change))
        assert words in found.verdict, (words, found.verdict)
    for words, change in (cases[0], *cases[2:]):
        assert dynid.identify_gravity(_changed(**change)).verdict.startswith("Poor"), words
    with pytest.raises(DataError, match="check the unit of the current"):
        dynid.identify_gravity(_changed(torque=lambda torque, time: 1000.0 * torque))


def test_a_wrong_direction_of_gravity_is_named():
    robot_file = _motion()[0].robot_file
    text = robot_file.text.replace("gravity: [0, 0, -9.81]", "gravity: [9.81, 0, 0]").replace(
        "mounting: table", "mounting: wall"
    )
    assert text != robot_file.text
    found = dynid.identify_gravity(_changed(), robot=parse_robot(text, where="wall", folder=None))
    assert "fit gravity along the base's z axis" in found.verdict
    assert found.verdict.startswith("Poor")
