"""Interface of a simulated arm that can be served on a bus; `sim_drivers.plant.plant.Plant` has it."""

from __future__ import annotations

from typing import Protocol

from drivers.core.arrays import FloatArray


class MeasurementLike(Protocol):
    """Sensor values of a simulated arm, each (n,) in SI units and °C."""

    @property
    def position(self) -> FloatArray: ...  # noqa: D102
    @property
    def velocity(self) -> FloatArray: ...  # noqa: D102
    @property
    def current(self) -> FloatArray: ...  # noqa: D102
    @property
    def torque(self) -> FloatArray: ...  # noqa: D102
    @property
    def temperature(self) -> FloatArray: ...  # noqa: D102
    @property
    def target_position(self) -> FloatArray: ...  # noqa: D102
    @property
    def target_velocity(self) -> FloatArray: ...  # noqa: D102
    @property
    def target_acceleration(self) -> FloatArray: ...  # noqa: D102
    @property
    def target_current(self) -> FloatArray: ...  # noqa: D102
    @property
    def target_torque(self) -> FloatArray: ...  # noqa: D102


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

    def measure(self) -> MeasurementLike:
        """The sensors' present values."""

    def heat(self, joint: int, celsius: float) -> None:
        """Raise a joint's temperature."""

    def block(self, joint: int) -> None:
        """Jam a joint."""

    def stick(self, joint: int, quantity: str) -> None:
        """Let a joint's sensor hang."""
