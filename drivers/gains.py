"""Motor signals and joint torque: Γ = G_T·V (SR400 .4.3 point 1), τ = K·I (AUBO eq. 2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.streams import FloatArray


@dataclass(frozen=True)
class DriveGain:
    """Joint torque per unit of a motor's signal, joint side, sign included.

    Attributes:
        gain: [N·m/A] or [N·m/V]; None where it is unknown.
        std: its standard deviation, same unit; None where it is unknown.
        signal: what is measured: "current", "voltage" or "torque".
    """

    gain: float | None
    std: float | None = None
    signal: str = "current"


def joint_torque(signal: FloatArray, gains: Sequence[DriveGain], coupling: FloatArray | None = None) -> FloatArray:
    """Joint torque (N, n) [N·m] from motor signals (N, n).

    `coupling` R (n, n) with q_motor = R·q_joint maps motor torques to the joints by Rᵀ; None for one motor a joint.

    Raises:
        ValueError: a gain is unknown.
    """
    factors = _known([gain.gain for gain in gains])
    motor = signal * factors
    return motor if coupling is None else motor @ coupling


def joint_torque_std(signal: FloatArray, gains: Sequence[DriveGain], coupling: FloatArray | None = None) -> FloatArray:
    """Standard deviation (N, n) [N·m] that the gains' uncertainty gives the torque, gains independent of each other.

    Raises:
        ValueError: a standard deviation is unknown.
    """
    variance = (signal * _known([gain.std for gain in gains])) ** 2
    return np.asarray(np.sqrt(variance if coupling is None else variance @ coupling**2))


def motor_signal(torque: FloatArray, gains: Sequence[DriveGain], coupling: FloatArray | None = None) -> FloatArray:
    """Motor signals (N, n) of joint torques (N, n) [N·m]: the inverse of `joint_torque`.

    Raises:
        ValueError: a gain is unknown, or the coupling cannot be inverted.
    """
    motor = torque if coupling is None else np.linalg.solve(coupling.T, torque.T).T
    return np.asarray(motor / _known([gain.gain for gain in gains]))


def _known(values: Sequence[float | None]) -> FloatArray:
    missing = [number + 1 for number, value in enumerate(values) if value is None]
    if missing:
        raise ValueError(f"unknown for joint(s) {', '.join(map(str, missing))}")
    return np.array(values, dtype=np.float64)
