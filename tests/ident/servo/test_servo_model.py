"""Servo models from simulated arms: the truth comes back, files are read again, wrong recordings are refused."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

import dynid
from daq.recording.recording import COMMANDS_STREAM, JOINTS_STREAM, Recording, Stream
from daq.robot.loader import load_robot
from ident.compiled.library import kernels
from ident.servo.arm_rollout import roll_out_arm, rollout_errors
from ident.servo.contact import ServoContact
from ident.servo.identify import _doubts, unexplained, verdict
from ident.servo.result import ServoParameter
from ident.servo.simulators.actuator_law import left_out, shaped_commands
from ident.servo.simulators.mjcf import MISSING, played_paths, servo_mjcf
from ident.servo.terms import INDEX
from studies.synthetic.data_mistakes import with_rows, with_values

WEIGHTED = ("shoulder_lift", "elbow_flex", "wrist_flex")
WEIGHTLESS = ("shoulder_pan", "gripper")


@pytest.fixture(scope="module")
def other() -> Recording:
    """A motion that is not fitted; simulated servos take a third of a second of processor time a second."""
    return dynid.simulate_servo("so101", duration=15.0, seed=2)


@pytest.fixture(scope="module")
def training() -> Recording:
    return dynid.simulate_servo("so101", duration=20.0, seed=1)


@pytest.fixture(scope="module")
def model(training, other) -> dynid.ServoModel:
    """The servos' profile is that of 39 rad/s²; the connection says 20."""
    file = load_robot("so101")
    said = file.robot.connections["feetech"].model_copy(update={"acceleration": 20.0})
    robot = file.robot.model_copy(update={"connections": {"feetech": said}})
    return dynid.identify_servo(training, validation=other, robot=file.model_copy(update={"robot": robot}))


@pytest.fixture(scope="module")
def folder(model, tmp_path_factory) -> Path:
    place = tmp_path_factory.mktemp("servo") / "model"
    model.save(place)
    return place


def test_a_held_out_motion_is_rolled_out_to_two_encoder_steps(model):
    shown = model.result.validation
    assert shown.held_out
    assert model.result.verdict.grade == "good"
    assert max(shown.rollout_error) < 2.0 * max(model.result.resolution)
    assert shown.rollout_mean < 0.2 * np.mean(shown.references.delay_and_lag)
    drawn = {trace.name: trace for trace in model.plot().data[:3]}
    measured, rolled = (drawn[name] for name in ("measured", "rolled out"))
    error = np.abs(np.interp(measured.x, rolled.x, rolled.y) - measured.y)[np.asarray(measured.x) > 1.0]
    assert np.mean(error) < 0.02
    assert len(model.plot(backend="matplotlib").axes) == len(model.result.joints)


def test_data_of_the_identification_do_not_count_twice_nor_as_held_out(model, training, other):
    position = training.streams[JOINTS_STREAM].channels["position"].values
    single = with_values(training, position=position.astype(np.float32).astype(np.float64))
    for copied in (single, with_rows(training, slice(500))):
        assert not model.validate(copied).result.validation.held_out
        with pytest.raises(dynid.UsageError, match="would count twice"):
            dynid.identify_servo([training, other, copied])
    assert model.validate(other).result.validation.held_out


def test_the_truth_comes_back_where_gravity_ties_the_torques(model):
    truth = model._robot.robot.truth.joints
    told = 0
    for joint in model.result.servo:
        if joint.joint not in WEIGHTED:
            continue
        true = truth[joint.joint]
        for name, value in (
            ("stiffness", true.servo.stiffness),
            ("damping", true.viscous),
            ("armature", true.motor_inertia),
        ):
            low, high = joint.parameters[name].interval
            assert low / 1.6 < value < 1.6 * high, (joint.joint, name)
            told += low <= value <= high
        low, high = joint.parameters["acceleration_limit"].interval
        assert 0.97 * low < true.servo.acceleration < 1.03 * high
    assert told >= 5, "of nine parameters"
    assert any("contradict the profile of 20 rad/s²" in check for check in model.result.verdict.checks)


def test_a_torque_that_nothing_ties_to_newton_metres_is_said_to_be_assumed(model):
    joints = {joint.joint: joint for joint in model.result.servo}
    truth = model._robot.robot.truth.joints
    for name in WEIGHTLESS:
        stiffness = joints[name].parameters["stiffness"]
        if stiffness.origin == "data":  # inertia of the links that it moves tells it
            low, high = stiffness.interval
            assert low / 1.1 <= truth[name].servo.stiffness <= 1.1 * high
            continue
        assert stiffness.unidentifiable
        assert stiffness.origin == "assumed"
        assert stiffness.interval is None
        assert any(name in check for check in model.result.verdict.checks)


def test_what_is_saved_is_read_again(model, folder):
    again = dynid.load_servo_model(folder)
    assert again.result == dynid.load_servo_model(folder / "result.json").result
    assert again.verdict == model.verdict
    assert again.parameters.names == model.parameters.names
    np.testing.assert_array_equal(again.result.values, model.result.values)
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "rollout-plot" in page
    assert model.result.verdict.headline in page


def test_the_commands_validate_and_export_take_it(folder, other, tmp_path, run_dynid):
    run = tmp_path / "run.h5"
    dynid.write_recording(run, other)
    status, output, error = run_dynid("validate", folder, run, "--json")
    assert status == 0, error
    judged = json.loads(output)["validation"]
    assert judged["held_out"]
    assert judged["rollout_mean"] < 4e-3
    status, output, error = run_dynid("export", folder, "--mjcf", tmp_path / "arm.xml")
    assert status == 0, error
    assert "position actuators" in output
    ranges = tmp_path / "ranges.json"
    status, output, error = run_dynid("export", folder, "--ranges", ranges)
    assert status == 0, error
    joint = json.loads(ranges.read_text(encoding="utf-8"))["joints"][1]
    assert np.shape(joint["covariance"]) == (len(joint["order"]),) * 2
    status, _, error = run_dynid("export", folder, "--urdf", tmp_path / "arm.urdf")
    assert status == 2
    assert "ranges" in error
    status, output, error = run_dynid("predict", folder, run, "-o", tmp_path / "rolled.h5", "--json")
    assert status == 0, error
    assert json.loads(output)["validation"]["rollout_mean"] == pytest.approx(judged["rollout_mean"])
    rolled = dynid.read_recording(tmp_path / "rolled.h5")
    assert np.abs(rolled.position - other.position)[100:].mean() == pytest.approx(judged["rollout_mean"], rel=0.3)


def test_a_part_that_begins_just_before_its_grid_keeps_all_its_samples(model):
    part = model.identification.motions[0].between(100, 300)
    early = dataclasses.replace(part, time=part.time - 1e-12)
    assert roll_out_arm([early], model._links, model.result.values)[0].shape == part.position.shape


def test_what_an_mjcf_holds_moves_in_mujoco_as_in_the_roll_out(model):
    pytest.importorskip("mujoco")
    values = model.result.values.copy()
    values[:, [INDEX[name] for name in ("load_friction", "breakaway", "load_breakaway", "dead_band")]] = 0.0
    motion = model.identification.motions[0].between(0, 500)
    path = roll_out_arm([motion], model._links, values)[0]
    shaped = dataclasses.replace(motion, position=path, command=shaped_commands(motion, values))
    played = played_paths(servo_mjcf(model._robot, model._links, values), model._links, [shaped])
    assert rollout_errors([shaped], played).mean() < 2e-3


def test_what_the_arm_touches_holds_it_up_in_mujoco_too(model):
    pytest.importorskip("mujoco")
    links, values = model._links, model.result.values
    motion = model.identification.motions[0].between(0, 400)
    link = 4
    heights = links.heights(link, motion.position.T)[0][0]
    name, height = links.model.link_names[link], float(np.median(heights))
    touched = ServoContact(link=name, point=[0.0] * 3, height=height, stiffness=2000.0)
    text = servo_mjcf(model._robot, links, values, (), touched)
    free, held = (played_paths(given, links, [motion])[0] for given in (servo_mjcf(model._robot, links, values), text))
    assert links.heights(link, free.T)[0][0].min() < touched.height - 0.01
    assert links.heights(link, held.T)[0][0].min() > touched.height - 0.004


def test_an_mjcf_as_it_came_is_a_reference(model, folder, other, tmp_path, run_dynid):
    pytest.importorskip("mujoco")
    path = tmp_path / "came.xml"
    text = servo_mjcf(model._robot, model._links, model.result.values)
    path.write_text(text.replace("<worldbody>", '<asset><mesh name="m" file="no.stl"/></asset><worldbody>'))
    judged = model.validate(other, model_file=path)
    shown = judged.result.validation
    assert np.mean(shown.rollout_error) < np.mean(shown.references.model_file) < 0.1
    assert "model_file" in {column.name for column in judged.errors.columns}
    path.write_text("<robot/>")
    run = tmp_path / "run.h5"
    dynid.write_recording(run, other)
    status, _, error = run_dynid("validate", folder, run, "--model-file", path)
    assert status == 2
    assert "URDF has no gains" in error
    steps: list[str] = []
    with pytest.raises(dynid.UsageError, match="URDF has no gains"):
        dynid.identify_servo(other, model_file=path, progress=steps.append)
    assert not steps  # before the fit, which takes a minute


def test_an_export_says_what_it_leaves_out_and_replaces_nothing_unasked(model, tmp_path):
    pytest.importorskip("mujoco")
    played = model.export_mjcf(tmp_path / "arm.xml")
    assert "friction that follows the load" in played.left_out
    assert played.model_error < played.error < 0.5 * played.identified_error
    with pytest.raises(dynid.UsageError, match="exists"):
        model.export_mjcf(tmp_path / "arm.xml")


def test_arms_that_the_data_allow_stay_within_the_intervals_and_differ(model):
    arms = [model.drawn(seed).result for seed in range(3)]
    for arm in arms:
        for joint in arm.servo:
            for name, parameter in joint.parameters.items():
                if parameter.interval is not None and not parameter.unidentifiable:
                    low, high = parameter.interval
                    assert low <= parameter.value <= high, (joint.joint, name)
    assert len({joint.parameters["damping"].value for arm in arms for joint in arm.servo}) == 3 * len(arms[0].servo)


def test_recordings_whose_commands_and_positions_do_not_belong_together_are_refused_in_a_line(
    other, tmp_path, run_dynid
):
    stream = other.streams[JOINTS_STREAM]
    position, command = (stream.channels[name].values for name in ("position", "target_position"))
    stuck, stopped, against = position.copy(), position.copy(), command.copy()
    stuck[:, 2], stopped[300:, 1], against[:, 1] = position[0, 2], position[300, 1], -command[:, 1]
    wrapped = position - 2 * np.pi * (np.eye(6)[1] * position > position[:, 1].mean())
    rest = stream.channels["target_position"], Stream(COMMANDS_STREAM, stream.time[:600], stream.time[:600], {})
    cut = dataclasses.replace(rest[1], channels={"target_position": dataclasses.replace(rest[0], values=command[:600])})
    bare = dataclasses.replace(stream, channels={"position": stream.channels["position"]})
    mistakes = {
        "late by 0.3 s": (with_values(other, target_position=np.roll(command, 15, axis=0)), "the clocks differ"),
        "measured ones": (with_values(other, target_position=np.roll(position, -1, axis=0)), "are the measured"),
        "wrapped": (with_values(other, position=wrapped), "full turn"),
        "order": (with_values(other, target_position=command[:, [0, 2, 1, 3, 4, 5]]), "commands of others"),
        "frozen": (with_values(other, position=stuck), "position of elbow_flex never"),
        "frozen halfway": (with_values(other, position=stopped), "shoulder_lift does not change from"),
        "degrees": (with_values(other, target_position=np.degrees(command)), "degrees"),
        "sign": (with_values(other, target_position=against), "against"),
        "shorter commands": (
            dataclasses.replace(other, streams={JOINTS_STREAM: bare, COMMANDS_STREAM: cut}),
            "commands end 2.98 s before",
        ),
        "short": (with_rows(other, slice(100)), "needs 3 s"),
    }
    for name, (run, words) in mistakes.items():
        path = tmp_path / f"{name}.h5"
        dynid.write_recording(path, run)
        out = tmp_path / name
        status, _, error = run_dynid("identify", path, "--method", "servo", "-o", out)
        assert status == 2, name
        assert words in error, (name, error)
        assert error.count("\n") <= 1, (name, error)
        assert not out.exists(), name


def test_declared_backlash_is_in_the_roll_out_and_named_where_a_file_cannot_express_it(model, other, tmp_path):
    if kernels().long is None:
        pytest.skip(kernels().said)
    joints = list(model.result.servo)
    play = ServoParameter(value=0.02, unit="rad", origin="given")
    joints[4] = joints[4].model_copy(update={"parameters": {**joints[4].parameters, "backlash": play}})
    loose = dynid.ServoModel(model.result.model_copy(update={"servo": joints}))
    loose.save(tmp_path / "loose")
    again = dynid.load_servo_model(tmp_path / "loose")
    assert again.result == loose.result
    paths = [each.roll_out(other)[0][1] for each in (again, model)]
    assert 1e-3 < np.abs(paths[0] - paths[1])[:, 4].mean() < 0.02
    assert "the backlash" in left_out(again.result.values, MISSING)
    assert np.array_equal(again.predict(other).position, np.concatenate([path for _, path in again.roll_out(other)]))


def test_errors_beyond_the_encoder_s_rounding_say_what_intervals_do_not_cover(model):
    assert not [text for text in model.result.verdict.checks if "model lacks" in text]
    (text,) = unexplained(("pan", "lift"), np.array([0.3, 1.2]))
    assert "lift 1.2 encoder steps" in text
    assert "pan" not in text


def test_the_grade_of_a_small_error_does_not_fall_because_the_encoder_is_finer(model):
    held_out = model.result.fit.model_copy(update={"held_out": True, "rollout_error": [2e-4] * 6})
    grades = {
        step: verdict(model.result.joints, model.result.servo, held_out, np.full(6, step)).grade
        for step in (1e-3, 1e-6)
    }
    assert grades == {1e-3: "good", 1e-6: "good"}


def test_positions_that_rest_jump_or_repeat_are_doubts_of_a_verdict(other):
    position = other.streams[JOINTS_STREAM].channels["position"].values
    stopped, jumped, repeated = position.copy(), position.copy(), position.copy()
    stopped[200:260, 1] = position[200, 1]
    jumped[400:, 3] += 0.5
    repeated[1::2] = repeated[:-1:2][: len(repeated[1::2])]
    assert not _doubts([other], other.robot())
    for changes, words in ((stopped, "shoulder_lift rests"), (jumped, "wrist_flex jumps"), (repeated, "repeat")):
        assert any(words in text for text in _doubts([with_values(other, position=changes)], other.robot())), words


def test_a_torque_method_names_the_servo_method_and_the_other_way_round(other, tmp_path, run_dynid):
    with pytest.raises(dynid.UsageError) as refused:
        dynid.identify(dynid.simulate("ur5e", duration=2.0), method="servo")
    assert "identify_servo" in str(refused.value)
    run = tmp_path / "run.h5"
    dynid.write_recording(run, other)
    status, _, error = run_dynid("identify", run, "--method", "servo", "--friction", "auto")
    assert status == 2
    assert "--friction" in error
