"""Interface of a simulated arm that can be served on a bus; `sim_drivers.plant.plant.Plant` has it."""

from __future__ import annotations

from typing import Protocol

from drivers.core.arrays import FloatArray
from sim_drivers.plant.sensors import Measurement


class SimulatedArm(Protocol):
    """Interface of a plant for the controller (`sim_drivers.plant.plant.Plant` is one)."""

    @property
    def time(self) -> float:
        """Virtual time [s]."""

    def set_target(
        self, position: FloatArray, velocity: FloatArray | None = None, acceleration: FloatArray | None = None
    ) -> None:
        """Reference of the joint controllers from now on, (n,)."""

    def halt(self, deceleration: float) -> None:
        """Brake to standstill at [rad/s²] and hold."""

    def advance(self, duration: float) -> None:
        """Advance virtual time [s]."""

    def measure(self) -> Measurement:
        """The sensors' present values."""

    def heat(self, joint: int, celsius: float) -> None:
        """Raise a joint's temperature."""

    def block(self, joint: int) -> None:
        """Jam a joint."""

    def stick(self, joint: int, quantity: str) -> None:
        """Let a joint's sensor hang."""


class DrivenArm(SimulatedArm, Protocol):
    """Interface of a plant for drives, which control its motors one by one; arrays are (n,)."""

    @property
    def position(self) -> FloatArray:
        """True position of the motors [rad]."""

    @property
    def velocity(self) -> FloatArray:
        """True velocity of the motors [rad/s]."""

    def push(self, torque: FloatArray) -> None:
        """Let the motors give these torques [N·m] from now on, within their limits; NaN where they are controlled."""

    def limit_torque(self, limit: FloatArray) -> None:
        """Let the motors give no more than this [N·m] from now on."""
