"""Friction experiments: the truth within the intervals, terms chosen, what the recordings do not determine."""

from __future__ import annotations

import json

import numpy as np
import pytest
from each import each
from friction_experiment_arm import GIVEN, arm, experiment, sweeps

from daq.recording.recording import Recording
from daq.robot.loader import load_robot, parse_robot
from drivers.core.errors import DataError, DynidError, ResultFileError, UsageError
from ident.excite.motion_check import ArmMotionCheck
from ident.excite.velocity_sweep import SweepChoices, velocity_sweep
from ident.experiments.friction.experiment import analyse_friction
from ident.experiments.friction.joint_data import friction_torque
from ident.result.friction_experiment import read_friction_experiment
from ident.tasks.experiments import friction
from sim_drivers.synthetic.measurement import simulate, simulate_recording

FIELDS = ("coulomb", "viscous", "offset", "load")


def off(joint) -> dict[str, float]:
    """Errors of a joint's values in σ."""
    truth = arm().robot.truth.joints[joint.joint]
    pairs = {name: (getattr(joint, name), getattr(truth, name), getattr(joint, f"{name}_std")) for name in FIELDS}
    pairs["alpha"] = (joint.exponent, truth.alpha, joint.exponent_std)
    for index in (0, 1):
        pairs[f"beta{index + 1}"] = (joint.temperature[index], truth.temperature[index], joint.temperature_std[index])
    return {name: abs(value - true) / std for name, (value, true, std) in pairs.items()}


@pytest.fixture(scope="module")
def given():
    return experiment()


def test_the_true_friction_lies_within_the_intervals(given):
    errors = {(joint.joint, name): error for joint in given.result.joints for name, error in off(joint).items()}
    assert len(errors) == 14
    assert max(errors.values()) < 6.0, errors
    assert np.mean(np.array(list(errors.values())) < 1.96) > 0.7, errors
    assert all(joint.rmse < 0.06 for joint in given.result.joints)


def test_terms_are_chosen_without_being_named():
    joints = {joint.joint: joint for joint in friction(sweeps(), delay=0.0).result.joints}
    for joint in joints.values():
        assert joint.load_power == 2.0
        assert joint.temperature_term == "linear"
        assert abs(joint.stribeck or 0.0) < 0.1
        assert joint.exponent is not None
        assert max(off(joint).values()) < 6.0


def test_the_load_on_the_tool_may_change_between_recordings(given):
    """The second pose has a heavier link: each period has gravity of its own, friction is common."""
    loads = {joint.joint: joint.load_range.greatest for joint in given.result.joints}
    assert loads["j1"] > 15.0
    assert [len(periods) for periods in given.experiment.periods.periods] == [4, 4]


def test_what_the_recordings_do_not_span_is_said_and_left_out():
    cold = sweeps()[:2]  # 2 K
    found = friction(cold, friction=GIVEN, delay=0.0)
    for joint in found.result.joints:
        assert joint.temperature_term == "none"
        assert joint.temperature is None
        assert "at least 5 are needed" in " ".join(joint.notes)
    without_heat = [
        Recording(one.robot_text, {name: _without_temperature(stream) for name, stream in one.streams.items()})
        for one in cold[:1]
    ]
    assert any("temperature was not recorded" in text for text in friction(without_heat, delay=0.0).warnings)


def _without_temperature(stream):
    channels = {name: channel for name, channel in stream.channels.items() if name != "temperature"}
    return type(stream)(stream.name, stream.time, stream.host_time, channels)


def test_the_curve_is_the_torque_of_the_coefficients(given):
    found = given.experiment
    joint = found.joints[0]
    velocity, kelvin, load, torque = joint.points
    model = friction_torque(found.periods.model, joint, velocity, kelvin, load)
    assert np.sqrt(np.mean((torque - model) ** 2)) < 0.2  # its columns are not filtered as the torque is


def test_the_result_is_written_read_and_shown(given, tmp_path):
    given.save(tmp_path)
    again = read_friction_experiment(tmp_path)
    assert again.model_dump() == given.result.model_dump() == json.loads(given.to_json())
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    for plot in ("speed-plot", "temperature-plot", "load-plot"):
        assert plot in page
    assert given.table.row("j1")["coulomb"] == again.joints[0].coulomb
    values, covariance = again.joints[0].part(("temperature", "temperature_slope"))
    assert values.shape == (2,)
    assert np.all(np.linalg.eigvalsh(covariance) > 0.0)


@each(
    ("edit", "message"),
    [
        (lambda content: content.pop("kind"), "is not a result of dynid friction"),
        (lambda content: content["joints"][0]["covariance"].pop(), "covariance is not"),
        (lambda content: content["joints"][0].update(exponent=40.0), "exponent 40 is not within"),
        (lambda content: content["joints"][0].update(load_power=3.0), "neither 1 nor 2"),
        (lambda content: content["joints"][0].update(temperature_term="full"), "do not agree"),
        (lambda content: content["joints"][0]["values"].append(1.0), "values for"),
    ],
)
def test_a_damaged_file_is_refused_in_one_line(given, tmp_path, edit, message):
    content = json.loads(given.to_json())
    edit(content)
    (tmp_path / "friction.json").write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(ResultFileError, match=message) as refused:
        read_friction_experiment(tmp_path)
    assert "\n" not in str(refused.value)


def test_what_cannot_be_analysed_is_refused():
    exciting = simulate("ur5e", duration=10.0, seed=1)
    refused: list[tuple[list, dict, type[DynidError], str]] = [
        ([], {}, UsageError, "no recording"),
        ([exciting], {}, DataError, "no joint moves back and forth while all others rest"),
        ([sweeps()[0], exciting], {}, DataError, "of "),
        ([sweeps()[0]], {"friction": "sticky"}, UsageError, "no friction model is called 'sticky'"),
        ([sweeps()[0]], {"robot_file": load_robot("sr400")}, DataError, "loops or coupled motors"),
    ]
    for recordings, options, kind, message in refused:
        with pytest.raises(kind, match=message) as error:
            analyse_friction(recordings, **options)
        assert "\n" not in str(error.value)


VERTICAL = """
name: portal
model:
  mounting: free
  mdh:
    - {joint: turn, alpha: 0, d: 0, r: 0.3}
    - {joint: lift, antecedent: turn, alpha: 0, d: 0.2, r: 0, type: prismatic}
joints:
  - {name: turn, position: [-2.5, 2.5], velocity: 2, acceleration: 8, torque: 100}
  - {name: lift, position: [0, 0.8], velocity: 1, acceleration: 5, torque: 300}
drives:
  - {joint: turn, gain: 10}
  - {joint: lift, gain: 80}
truth:
  links:
    turn: {mass: 4, com: [0.1, 0.02, 0.02], inertia: [0.02, 0, 0, 0.06, 0, 0.06]}
    lift: {mass: 3, com: [0.1, 0.02, 0.03], inertia: [0.01, 0, 0, 0.03, 0, 0.03]}
  joints:
    turn: {viscous: 3, coulomb: 4, offset: 0.3, motor_inertia: 0.3}
    lift: {viscous: 25, coulomb: 12, offset: 0, motor_inertia: 2}
  noise:
    rate: 100
    torque_std: {turn: 0.05, lift: 0.1}
"""


def test_a_vertical_axis_and_a_prismatic_joint_carry_what_they_carry():
    robot_file = parse_robot(VERTICAL, where="portal", folder=None)
    choices = SweepChoices(stroke=0.6, slowest=0.1, speeds=4)
    motion = velocity_sweep(robot_file, ArmMotionCheck(robot_file), choices).motion
    turn, lift = friction([simulate_recording(robot_file, motion, motion.duration, 1)], delay=0.0).result.joints
    assert "gravity does not act on this joint" in " ".join(turn.notes)
    assert turn.load_range.greatest == 0.0
    assert lift.offset is None
    truth = robot_file.robot.truth.joints
    for joint in (turn, lift):
        for name in ("coulomb", "viscous"):
            value, std = getattr(joint, name), getattr(joint, f"{name}_std")
            assert abs(value - getattr(truth[joint.joint], name)) < 5.0 * std
    assert abs(turn.offset - 0.3) < 5.0 * turn.offset_std
