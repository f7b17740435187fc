"""A plant that follows its target exactly, for tests of the servers in front of it."""

from __future__ import annotations

import numpy as np

from drivers.core.arrays import FloatArray
from sim_drivers.plant.sensors import Measurement

JOINT_NAMES = tuple(f"j{number}" for number in range(1, 7))


class ExactPlant:
    """Current is 0.5 A plus the position, torque ten times that, so that a test can distinguish them."""

    def __init__(self, joints: int = 6) -> None:
        self.time = 0.0
        self.position = np.linspace(-0.5, 0.5, joints)
        self.velocity = np.zeros(joints)
        self.acceleration = np.zeros(joints)
        self.temperature = np.linspace(25.0, 30.0, joints)
        self.halted = False

    def set_target(
        self, position: FloatArray, velocity: FloatArray | None = None, acceleration: FloatArray | None = None
    ) -> None:
        self.position = position.copy()
        self.velocity = np.zeros_like(position) if velocity is None else velocity.copy()
        self.acceleration = np.zeros_like(position) if acceleration is None else acceleration.copy()
        self.halted = False

    def halt(self, deceleration: float) -> None:
        self.velocity = np.zeros_like(self.position)
        self.acceleration = np.zeros_like(self.position)
        self.halted = True

    def limit_torque(self, limit: FloatArray) -> None:
        self.torque_limit = limit.copy()

    def advance(self, duration: float) -> None:
        self.time += duration

    def heat(self, joint: int, celsius: float) -> None:
        self.temperature[joint] += celsius

    def block(self, joint: int) -> None:
        self.blocked = joint

    def stick(self, joint: int, quantity: str) -> None:
        self.stuck = quantity, joint

    def measure(self) -> Measurement:
        current = 0.5 + self.position
        return Measurement(
            self.time,
            self.position,
            self.velocity,
            current,
            10.0 * current,
            self.temperature,
            self.position,
            self.velocity,
            self.acceleration,
            current,
            lambda: 10.0 * current,
        )
