"""What a source of samples delivers: streams of channels, described before the first sample, handed out in blocks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from drivers.core.arrays import BoolArray, FloatArray

UNITS: Mapping[str, str] = {
    "position": "rad",
    "velocity": "rad/s",
    "acceleration": "rad/s^2",
    "current": "A",
    "voltage": "V",
    "torque": "N*m",
    "temperature": "degC",
    "target_position": "rad",
    "target_velocity": "rad/s",
    "target_acceleration": "rad/s^2",
    "target_current": "A",
    "target_torque": "N*m",
    "gain_p": "N*m/rad",
    "gain_d": "N*m*s/rad",
}
"""Unit of each quantity that dynid knows; another quantity brings its own."""

GOAL_AGE = "goal_age"
"""For how long [s] a goal that the motor takes in one step had been in force when its torque was measured."""
ENABLED = "enabled"
"""Whether a motor drives: 1 or 0, nan where it does not say."""
MOTOR_ON: Mapping[str, tuple[int, int]] = {
    "statusword": (0x4, 0x4),
    "joint_mode": (~0, 253),
    "robot_mode": (~0, 7),
    ENABLED: (~0, 1),
}
"""Status quantities, their bits that say whether a motor is on, and these bits where it is: "operation enabled" (CiA
402-2, statusword), "running" (UR's RTDE guide, joint and robot modes)."""
COMMANDS = ("target_position", "target_velocity", "target_torque", "gain_p", "gain_d")
"""Quantities that a controller was given: set points, feed-forward torque, gains of its loop."""


@dataclass(frozen=True)
class ChannelLayout:
    """What one dataset of a stream holds."""

    quantity: str  # name of the dataset (`position`, `current`, …)
    columns: tuple[str, ...]  # names of its n columns; joint names wherever it has one a joint
    unit: str = ""  # unit of every value; taken from `UNITS` where empty
    description: str = ""  # where the values come from, in words
    magnitude: bool = False  # whether the values have lost their sign

    def __post_init__(self) -> None:
        if not self.unit:
            if self.quantity not in UNITS:
                raise ValueError(f"quantity '{self.quantity}' needs a unit")
            object.__setattr__(self, "unit", UNITS[self.quantity])


@dataclass(frozen=True)
class StreamLayout:
    """A stream before its first sample."""

    name: str  # of the group under /streams
    channels: tuple[ChannelLayout, ...]  # its datasets
    rate: float = 0.0  # nominal rate [Hz], sets the chunk length; 0 where unknown
    # whether a motion must not go on while the stream is silent; its driver tells a silence otherwise
    essential: bool = True


@dataclass(frozen=True)
class Batch:
    """Consecutive samples of one stream."""

    stream: str  # name of the stream
    time: FloatArray  # (N,) the source's own clock [s]
    host_time: FloatArray  # (N,) the host's monotonic clock at reception [s]
    values: Mapping[str, FloatArray] = field(default_factory=dict)  # quantity → (N, n)
    lost: int = 0  # samples that the source's clock or counter says are missing before or within this block


def motors_on(quantity: str, values: FloatArray) -> BoolArray:
    """Return which values (N, n) of a status quantity of `MOTOR_ON` do not say that their motor is off."""
    mask, on = MOTOR_ON[quantity]
    return np.asarray(np.isnan(values) | (np.nan_to_num(values).astype(np.int64) & mask == on))
