"""Set-up of a simulated drive, and its measurement."""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.canopen402.protocol import objects

QUICK_STOP_RAMP = 20.0
"""Default of object 0x6085 [rad/s²]."""
LARGEST_FOLLOWING_ERROR = 0.25
"""Default of object 0x6065 [rad]."""


@dataclass(frozen=True)
class DriveSetup:
    """Ratings of a drive and its mounting."""

    serial: int  # serial number
    increments: int = 8192  # of the encoder a motor revolution
    gear: int = 64  # motor revolutions a joint revolution
    direction: int = 1  # of the drive's counts against the joint, 1 or -1
    zero: float = 0.0  # joint position at count 0 [rad]
    rated_current: float = 5.0  # [A]
    rated_torque: float = 50.0  # joint side [N·m]
    velocity: float = 0.5  # of profiles, unless the master sets another [rad/s]
    acceleration: float = 5.0  # of profiles, unless the master sets another [rad/s²]
    # lowest, highest: software position limits of the joint [rad]; none where they are infinite
    lowest: float = -math.inf
    highest: float = math.inf
    largest_velocity: float = math.inf  # of profiles [rad/s]
    largest_torque: float = math.inf  # joint side [N·m]

    @property
    def counts_per_radian(self) -> float:
        """Position counts per rad of the joint, sign included."""
        return self.direction * self.increments * self.gear / (2.0 * math.pi)


@dataclass(frozen=True)
class DriveFeedback:
    """A drive's measurement of its joint [rad, rad/s, N·m, A, °C]."""

    position: float
    velocity: float = 0.0
    torque: float = 0.0
    current: float = 0.0
    temperature: float = 20.0


def fixed_values(setup: DriveSetup) -> dict[tuple[int, int], int | str]:
    """Objects whose values are this drive's own, by index and subindex."""
    scale = abs(setup.counts_per_radian)
    limited = math.isfinite(setup.lowest) and math.isfinite(setup.highest)
    ends = [round((end - setup.zero) * setup.counts_per_radian) for end in (setup.lowest, setup.highest) if limited]
    return {
        (objects.LOWEST_POSITION.index, objects.LOWEST_POSITION.subindex): max(min(ends, default=0), -(1 << 31)),
        (objects.HIGHEST_POSITION.index, objects.HIGHEST_POSITION.subindex): min(max(ends, default=0), (1 << 31) - 1),
        (objects.MAX_PROFILE_VELOCITY.index, 0): round(min(setup.largest_velocity * scale, 2**32 - 1)),
        (objects.MAX_TORQUE.index, 0): round(min(1e3 * setup.largest_torque / setup.rated_torque, 2**16 - 1)),
        (objects.FOLLOWING_ERROR_WINDOW.index, 0): round(LARGEST_FOLLOWING_ERROR * scale),
        (objects.SERIAL.index, objects.SERIAL.subindex): setup.serial,
        (objects.ENCODER_INCREMENTS.index, 1): setup.increments,
        (objects.ENCODER_TURNS.index, 2): 1,
        (objects.GEAR_MOTOR_TURNS.index, 1): setup.gear,
        (objects.GEAR_SHAFT_TURNS.index, 2): 1,
        (objects.RATED_CURRENT.index, 0): round(1e3 * setup.rated_current),
        (objects.RATED_TORQUE.index, 0): round(1e3 * setup.rated_torque),
        (objects.PROFILE_VELOCITY.index, 0): round(setup.velocity * scale),
        (objects.PROFILE_ACCELERATION.index, 0): round(setup.acceleration * scale),
        (objects.PROFILE_DECELERATION.index, 0): round(setup.acceleration * scale),
        (objects.QUICK_STOP_DECELERATION.index, 0): round(QUICK_STOP_RAMP * scale),
    }
