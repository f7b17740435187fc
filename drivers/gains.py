"""Joint torque out of motor signals: Γ = G_T·V (SR400 §4.3 point 1), τ = K·I (AUBO eq. 2), coupled motors by Rᵀ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.streams import ChannelLayout


@dataclass(frozen=True)
class DriveGain:
    """Joint torque per unit of a motor's signal, joint side, sign included."""

    gain: float | None  # [N·m/A] or [N·m/V]; None where it is unknown
    std: float | None = None  # its standard deviation, same unit; None where it is unknown
    signal: str = "current"  # what is measured: "current", "voltage" or "torque"


def joint_torque(signal: FloatArray, gains: Sequence[DriveGain], coupling: FloatArray | None = None) -> FloatArray:
    """Joint torque (N, n) [N·m] of the motors' signals (N, n): the one way from a current to a torque.

    Args:
        signal: currents [A] or voltages [V], a column per motor.
        gains: n, one per motor.
        coupling: R (n, n) of q_motor = R·q_joint; None where each motor moves its own joint alone.

    Raises:
        ValueError: a gain is unknown.
    """
    factors = [gain.gain for gain in gains if gain.gain is not None]
    if len(factors) < len(gains):
        unknown = [str(number) for number, gain in enumerate(gains, start=1) if gain.gain is None]
        raise ValueError(f"no gain is known for motor {' or '.join(unknown)}")
    with np.errstate(over="ignore", invalid="ignore"):  # of a damaged file: no number, and refused where it is used
        motor_torque = signal * np.array(factors, dtype=np.float64)
        return motor_torque if coupling is None else torque_at_joints(motor_torque, coupling)


def torque_at_joints(motor_torque: FloatArray, coupling: FloatArray) -> FloatArray:
    """Joint torque (N, n) = Rᵀ·Γ_motor [N·m] of motor torques (N, n) [N·m], by which both give the same power."""
    # Joint by joint over the motors that move it: in a product of matrices, one NaN would reach every joint.
    moving = coupling != 0.0
    columns = [motor_torque[:, moving[:, joint]] @ column[moving[:, joint]] for joint, column in enumerate(coupling.T)]
    return np.stack(columns, axis=1)


def gives_torque(gains: Sequence[DriveGain], joints: Sequence[str]) -> bool:
    """Return whether currents become torques: every joint has a motor whose gain [N·m/A] is known."""
    return len(gains) == len(joints) and all(gain.gain is not None and gain.signal == "current" for gain in gains)


def torque_channel(joints: Sequence[str], coupling: FloatArray | None) -> ChannelLayout:
    """The channel that `joint_torque` fills from currents."""
    at_joints = "" if coupling is None else ", transformed from the coupled motors to the joints"
    return ChannelLayout("torque", tuple(joints), "", f"current times the robot file's drive gains{at_joints}")
