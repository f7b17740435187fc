from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from drivers.gains import DriveGain, joint_torque, joint_torque_std, motor_signal

SIGNALS = arrays(np.float64, (7, 3), elements=st.floats(-50, 50))
GAIN_VALUES = st.lists(st.floats(0.1, 100).flatmap(lambda size: st.sampled_from([size, -size])), min_size=3, max_size=3)
# Motors 2 and 3 both move joint 3, as in a parallelogram; determinant 1, so that it can be inverted.
COUPLING = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 1.0]])


def gains(values: list[float], std: float | None = 0.1) -> list[DriveGain]:
    return [DriveGain(value, std) for value in values]


@given(SIGNALS, GAIN_VALUES)
def test_each_joint_has_its_gain_and_sign(signal: np.ndarray, values: list[float]) -> None:
    torque = joint_torque(signal, gains(values))
    for joint, value in enumerate(values):
        assert np.array_equal(torque[:, joint], signal[:, joint] * value)


@given(SIGNALS, GAIN_VALUES, st.booleans())
def test_signal_and_torque_are_inverse(signal: np.ndarray, values: list[float], coupled: bool) -> None:
    coupling = COUPLING if coupled else None
    torque = joint_torque(signal, gains(values), coupling)
    assert np.allclose(motor_signal(torque, gains(values), coupling), signal, atol=1e-9)


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
    assert np.array_equal(joint_torque_std(signal, some, np.eye(3)), joint_torque_std(signal, some))


@pytest.mark.parametrize("coupling", [None, COUPLING])
def test_the_standard_deviation_is_that_of_sampled_gains(coupling: np.ndarray | None) -> None:
    rng = np.random.default_rng(7)
    signal = np.array([[2.0, -3.0, 1.5], [0.0, 4.0, -1.0]])
    mean, std = np.array([10.0, -8.0, 5.0]), np.array([0.5, 0.4, 0.2])
    stated = joint_torque_std(signal, [DriveGain(m, s) for m, s in zip(mean, std, strict=True)], coupling)
    draws = 20_000
    sampled = np.array(
        [joint_torque(signal, gains(list(row)), coupling) for row in rng.normal(mean, std, (draws, 3))]
    ).std(axis=0)
    # The sampled standard deviation is itself uncertain by 1/√(2·draws) = 0.5 %.
    assert np.allclose(sampled, stated, rtol=0.025, atol=1e-12)


@pytest.mark.parametrize("function", [joint_torque, joint_torque_std, motor_signal])
def test_unknown_gains_are_named(function: object) -> None:
    some = [DriveGain(1.0, 0.1), DriveGain(None), DriveGain(None, 0.2)]
    words = "joint\\(s\\) 2$" if function is joint_torque_std else "joint\\(s\\) 2, 3"
    with pytest.raises(ValueError, match=words):
        function(np.ones((4, 3)), some)  # type: ignore[operator]


def test_the_signal_is_not_changed() -> None:
    signal = np.ones((4, 3))
    joint_torque(signal, gains([2.0, 3.0, 4.0]), COUPLING)
    joint_torque_std(signal, gains([2.0, 3.0, 4.0]), COUPLING)
    assert np.array_equal(signal, np.ones((4, 3)))
