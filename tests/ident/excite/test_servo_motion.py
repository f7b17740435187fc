"""Motions for servo models: within all limits, of every kind, and where intervals are still wide."""

from __future__ import annotations

import json

import numpy as np
import pytest
from servo_result import true_servo_result

import dynid
from daq.robot.loader import RobotFile, load_robot
from ident.excite import servo_motion
from ident.excite.choices import ServoMotionChoices
from ident.excite.servo_motion import servo_excitation
from ident.excite.servo_segments import KINDS, LADDER, SEGMENT, Room, segment
from ident.servo.result import ServoResult


class EverywhereClear:
    """In place of the arm's own check, which has tests of its own."""

    def clear(self, position):
        return np.ones(position.shape[1], dtype=bool)

    def trajectory(self, motion, where):
        return None


@pytest.fixture(autouse=True)
def few_poses(monkeypatch):
    monkeypatch.setattr(servo_motion, "POSES", 1)
    monkeypatch.setattr(servo_motion, "LADDER", (1.0,))


@pytest.fixture(scope="module")
def file() -> RobotFile:
    return load_robot("so101")


def known(file: RobotFile, sigma: float, wide: dict[str, float] | None = None) -> ServoResult:
    """A model whose parameters have all the same σ, but those of some joints."""
    result = true_servo_result(file, sigma)
    covariance = [
        (np.array(matrix) * (wide or {}).get(joint, 1.0) ** 2).tolist()
        for joint, matrix in zip(result.joints, result.covariance, strict=True)
    ]
    return result.model_copy(update={"covariance": covariance})


def room(file: RobotFile) -> Room:
    joints = file.robot.joints
    low, high = (np.array(ends) for ends in zip(*(joint.position for joint in joints), strict=True))
    return Room(
        low, high, np.array([joint.velocity for joint in joints]), np.array([joint.acceleration for joint in joints])
    )


def test_pieces_keep_limits_and_begin_and_end_at_rest_in_their_pose(file):
    limits = room(file)
    centre = np.clip(np.zeros(6), limits.low + 0.1, limits.high - 0.1)
    for kind in KINDS:
        sizes = []
        for share in LADDER:
            position = segment(kind, share, 0, centre, limits, 1).position
            step = SEGMENT / (len(position) - 1)
            np.testing.assert_allclose(position[[0, -1]], [centre, centre], atol=1e-9)
            speed, rate = np.diff(position, axis=0) / step, np.diff(position, 2, axis=0) / step**2
            assert np.all(np.abs(speed) <= limits.velocity)
            assert np.all(np.abs(rate) <= 1.05 * limits.acceleration), kind
            assert np.all((position >= limits.low) & (position <= limits.high))
            sizes.append(np.ptp(position, axis=0).mean())
        assert kind == "chirp" or sizes == sorted(sizes), kind  # a chirp is as large as its accelerations may be


def test_a_first_motion_has_every_kind_and_a_stated_time_and_is_played_by_the_simulated_arm(tmp_path, run_dynid):
    target = ["--length", "15", "-o", tmp_path / "motion.yaml", "--csv", tmp_path / "motion.csv", "--json"]
    status, output, error = run_dynid("excite", "so101", "--for", "servo", *target)
    assert status == 0, error
    told = json.loads(output)
    assert 8.0 < told["duration"] <= 15.0
    assert {piece["kind"] for piece in told["pieces"]} == set(KINDS)
    motion = dynid.load_trajectory(tmp_path / "motion.yaml", "so101")
    assert motion.duration == pytest.approx(told["duration"])
    table = np.loadtxt(tmp_path / "motion.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(table[:, 1:], motion.evaluate(table[:, 0])[0], atol=1e-6)
    target = ["sim", "so101", "--play", tmp_path / "motion.yaml", "-o", tmp_path / "run.h5"]
    status, _, error = run_dynid(*target)
    assert status == 0, error
    played = dynid.read_recording(tmp_path / "run.h5").streams["joints"]
    commands = played.channels["target_position"].values
    np.testing.assert_allclose(commands, motion.evaluate(np.minimum(played.time, motion.duration))[0], atol=1e-8)
    status, _, error = run_dynid(*target[:4])
    assert status == 2
    assert "--out" in error
    # and the way back of a user's own log of it
    names, log = motion.joint_names, tmp_path / "log.csv"
    rows = np.column_stack([played.time, played.channels["position"].values, commands])
    header = ["time", *(f"position_{name}" for name in names), *(f"target_{name}" for name in names)]
    np.savetxt(log, rows, delimiter=",", header=",".join(header), comments="", fmt="%.6f")
    columns = ["--column", "position=position_{}", "--column", "target_position=target_{}"]
    imported = ["import", log, "--robot", "so101", *columns, "-o", tmp_path / "log.h5"]
    status, _, error = run_dynid(*imported)
    assert status == 0, error
    again = dynid.read_recording(tmp_path / "log.h5").streams["joints"].channels["target_position"].values
    np.testing.assert_allclose(again, commands, atol=1e-6)


def test_what_is_wide_decides_and_enough_is_said(file):
    check, choices = EverywhereClear(), ServoMotionChoices(length=20.0, wanted=10.0)
    nothing = servo_excitation(file, check, known(file, 0.02), choices)
    assert nothing.enough
    assert nothing.motion is None
    little = servo_excitation(file, check, known(file, 0.02, {"elbow_flex": 3.0}), choices)
    assert {one.joint for one in little.forecast} == {"elbow_flex"}
    assert all(one.then < one.now for one in little.forecast if one.parameter != "torque_limit")
    more = servo_excitation(file, check, known(file, 0.2), choices)
    assert len(more.segments) > len(little.segments) > 0
    assert more.motion.duration <= 20.0


def test_a_model_that_is_good_enough_needs_no_motion_and_one_of_another_arm_is_refused(file, tmp_path, run_dynid):
    model = tmp_path / "model"
    dynid.ServoModel(known(file, 0.02)).save(model)
    arguments = ["--for", "servo", "--after", model, "-o", tmp_path / "m.yaml"]
    status, output, error = run_dynid("excite", "so101", *arguments)
    assert status == 0, error
    assert "enough" in output
    assert not (tmp_path / "m.yaml").exists()
    for arm in ("ur5e", "koch"):  # a Koch's joints have the same names
        status, _, error = run_dynid("excite", arm, *arguments)
        assert status == 2
        assert "is of so101" in error
