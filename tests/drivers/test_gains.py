from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from drivers.gains import DriveGain, gives_torque, joint_torque, torque_channel

SIGNALS = arrays(np.float64, (7, 3), elements=st.floats(-50, 50))
GAIN_VALUES = st.lists(st.floats(0.1, 100).flatmap(lambda size: st.sampled_from([size, -size])), min_size=3, max_size=3)
JOINTS = ("shoulder", "elbow", "wrist")
# The wrist's motor turns with the elbow, too.
COUPLING = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 1.0]])


def gains(values: list[float], std: float | None = 0.1) -> list[DriveGain]:
    return [DriveGain(value, std) for value in values]


@given(SIGNALS, GAIN_VALUES)
def test_each_joint_has_its_gain_and_sign(signal: np.ndarray, values: list[float]) -> None:
    torque = joint_torque(signal, gains(values))
    for joint, value in enumerate(values):
        assert np.array_equal(torque[:, joint], signal[:, joint] * value)


@given(SIGNALS, GAIN_VALUES, arrays(np.float64, (7, 3), elements=st.floats(-5, 5)))
def test_coupling_conserves_power(signal: np.ndarray, values: list[float], velocity: np.ndarray) -> None:
    # τ_motorᵀ q̇_motor = Γᵀ q̇ with q̇_motor = R q̇
    motor_torque = joint_torque(signal, gains(values))
    joint = joint_torque(signal, gains(values), COUPLING)
    at_motors = np.sum(motor_torque * (velocity @ COUPLING.T), axis=1)
    assert np.allclose(np.sum(joint * velocity, axis=1), at_motors, atol=1e-8)


def test_an_identity_couples_nothing() -> None:
    signal = np.arange(6.0).reshape(2, 3)
    some = gains([1.0, -2.0, 3.0])
    assert np.array_equal(joint_torque(signal, some, np.eye(3)), joint_torque(signal, some))


def test_a_motor_without_a_reading_tells_nothing_of_joints_that_it_does_not_move() -> None:
    signal = np.array([[np.nan, 1.0, 2.0]])
    assert np.array_equal(joint_torque(signal, gains([1.0, 1.0, 1.0]), COUPLING), [[np.nan, -1.0, 2.0]], equal_nan=True)


def test_unknown_gains_are_named_and_give_no_torque() -> None:
    some = [DriveGain(1.0, 0.1), DriveGain(None), DriveGain(None, 0.2)]
    with pytest.raises(ValueError, match="for motor 2 or 3"):
        joint_torque(np.ones((4, 3)), some)
    assert not gives_torque(some, JOINTS)
    assert not gives_torque([DriveGain(1.0, signal="voltage")] * 3, JOINTS)
    assert not gives_torque(gains([1.0]), JOINTS)
    assert gives_torque(gains([1.0, 2.0, 3.0]), JOINTS)


def test_the_recording_says_where_a_torque_came_from() -> None:
    assert torque_channel(JOINTS, None).description == "current times the robot file's drive gains"
    assert "coupled motors" in torque_channel(JOINTS, COUPLING).description


def test_the_signal_is_not_changed() -> None:
    signal = np.ones((4, 3))
    joint_torque(signal, gains([2.0, 3.0, 4.0]), COUPLING)
    assert np.array_equal(signal, np.ones((4, 3)))
