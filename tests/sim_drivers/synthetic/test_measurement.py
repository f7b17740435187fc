"""Simulated recordings: the exact torque underneath, and the sensors' errors on top."""

from __future__ import annotations

import numpy as np
import pytest
from arm_kinds import ARM_KINDS
from each import each

from daq.recording.reader import read_recording
from daq.recording.recording import JOINTS_STREAM
from daq.recording.writer import write_recording
from daq.robot.loader import load_robot, parse_robot
from drivers.core.errors import RobotFileError
from ident.model.dynamic_model import build_model
from ident.model.dynamics.pinocchio_model import pinocchio_model
from ident.model.true_parameters import truth_vector
from ident.signals.joint_signals import read_joint_signals
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording

SIMULATED = [name for name in ARM_KINDS if load_robot(name).robot.truth.links]


@pytest.fixture(scope="module")
def ur5e():
    return load_robot("ur5e")


@pytest.fixture(scope="module")
def motion(ur5e):
    return random_fourier_motion(build_model(ur5e), 10.0, seed=1, candidates=3)


def without_noise(robot_file):
    text = robot_file.text
    return parse_robot(text[: text.index("  noise:")], where="noise-free", folder=None)


def joints_of(recording):
    return recording.streams[JOINTS_STREAM]


def test_the_seed_decides(ur5e, motion):
    one, same, other = (joints_of(simulate_recording(ur5e, motion, 1.0, seed)) for seed in (4, 4, 5))
    for quantity in ("position", "current"):
        assert np.array_equal(one.channels[quantity].values, same.channels[quantity].values)
    assert np.array_equal(one.channels["position"].values, other.channels["position"].values)
    assert not np.array_equal(one.channels["current"].values, other.channels["current"].values)


def test_positions_are_multiples_of_the_encoders_step(ur5e, motion):
    step = ur5e.robot.truth.noise.encoder_resolution
    stream = joints_of(simulate_recording(ur5e, motion, 2.0, seed=1))
    counts = stream.channels["position"].values / step
    assert np.allclose(counts, np.round(counts), rtol=0, atol=1e-6)
    exact, _, _ = motion.evaluate(stream.time)
    assert np.max(np.abs(stream.channels["position"].values.T - exact)) <= 0.5001 * step


def test_current_times_gain_is_rnea_plus_friction_and_motor(ur5e, motion):
    """Newton-Euler of Pinocchio, friction and motor inertia written out: no code shared with the simulation."""
    import pinocchio as pin

    perfect = without_noise(ur5e)
    recording = simulate_recording(perfect, motion, 0.2, seed=1)
    model, truth = build_model(perfect), truth_vector(perfect)
    arm = pinocchio_model(model, truth[: 10 * model.dof])
    data = arm.createData()
    q, dq, ddq = motion.evaluate(joints_of(recording).time)
    torque = read_joint_signals(recording, perfect.robot).torque
    for sample in range(0, len(torque), 10):
        expected = pin.rnea(arm, data, q[:, sample], dq[:, sample], ddq[:, sample])
        for joint, name in enumerate(perfect.robot.joint_names):
            true = perfect.robot.truth.joints[name]
            expected[joint] += true.viscous * dq[joint, sample] + true.coulomb * np.sign(dq[joint, sample])
            expected[joint] += true.offset + true.motor_inertia * ddq[joint, sample]
        assert np.allclose(torque[sample], expected, rtol=0, atol=1e-9 * np.max(np.abs(expected)))


def test_noise_is_as_large_as_the_file_says(ur5e, motion):
    noise = ur5e.robot.truth.noise
    recorded = read_joint_signals(simulate_recording(ur5e, motion, 10.0, seed=1), ur5e.robot)
    exact = read_joint_signals(simulate_recording(without_noise(ur5e), motion, 10.0, seed=1), ur5e.robot)
    added = recorded.torque - exact.torque
    for joint, name in enumerate(ur5e.robot.joint_names):
        variance = noise.torque_std[name] ** 2 + noise.ripple_amplitude[name] ** 2 / 2
        assert np.std(added[:, joint]) == pytest.approx(np.sqrt(variance), rel=0.08)
    assert np.max(np.abs(np.corrcoef(added.T) - np.eye(6))) < 0.1


@each("rate", [None, 125.0, 1000.0])
def test_stamps_are_the_rates(ur5e, motion, rate):
    stream = joints_of(simulate_recording(ur5e, motion, 1.6, seed=1, rate=rate))
    assert len(stream.time) == round(1.6 * (rate or ur5e.robot.truth.noise.rate))
    assert np.allclose(np.diff(stream.time), 1 / (rate or 500.0), rtol=0, atol=1e-12)
    assert stream.channels["position"].values.shape == (len(stream.time), 6)


@pytest.mark.parametrize("name", SIMULATED)
def test_every_arm_with_a_truth_can_be_recorded(name, tmp_path):
    robot_file = load_robot(name)
    motion = random_fourier_motion(build_model(robot_file), 8.0, seed=1, candidates=2)
    recording = simulate_recording(robot_file, motion, 0.5, seed=1)
    drives = [robot_file.robot.drive(joint) for joint in robot_file.robot.joint_names]
    signal = drives[0].signal if all(drive.gain is not None for drive in drives) else "torque"
    channels = joints_of(recording).channels
    assert set(channels) == {"position", signal}
    write_recording(tmp_path / "run.h5", recording)
    again = read_recording(tmp_path / "run.h5")
    assert np.array_equal(joints_of(again).channels["position"].values, channels["position"].values)
    assert again.robot().robot == robot_file.robot


def test_a_coupled_arm_s_torque_is_recorded_at_its_joints():
    """Voltage with gains and torque without are both read back as the same motor torques."""
    robot_file = without_noise(load_robot("sr400"))
    text = robot_file.text
    start, end = text.index("\ndrives:\n"), text.index("\nfriction:")
    bare = parse_robot(text[:start] + text[end:], where="bare", folder=None)
    motion = random_fourier_motion(build_model(robot_file), 8.0, seed=1, candidates=2)
    at_motors = read_joint_signals(simulate_recording(robot_file, motion, 1.0, seed=1), robot_file.robot)
    recording = simulate_recording(bare, motion, 1.0, seed=1)
    from_joints = read_joint_signals(recording, bare.robot)
    np.testing.assert_allclose(from_joints.torque, at_motors.torque, atol=1e-9)
    recorded = joints_of(recording).channels["torque"].values
    assert np.allclose(recorded[:, 3], at_motors.torque[:, 3] + at_motors.torque[:, 4], atol=1e-9)


def test_an_arm_without_a_truth_is_refused(ur5e, motion):
    text = ur5e.text[: ur5e.text.index("truth:\n  #")]
    with pytest.raises(RobotFileError, match="no true link"):
        simulate_recording(parse_robot(text, where="real", folder=None), motion, 1.0, seed=1)
