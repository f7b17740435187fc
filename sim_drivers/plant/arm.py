"""What a simulated arm must offer to be served on a bus; `sim_drivers.plant.plant.Plant` does."""

from __future__ import annotations

from typing import Protocol

from drivers.streams import FloatArray


class MeasurementLike(Protocol):
    """What the sensors of a simulated arm give, each (n,) in SI units and °C."""

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
    """What the controller needs of a plant (`sim_drivers.plant.plant.Plant` is one)."""

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
        """Let virtual time pass [s]."""

    def measure(self) -> MeasurementLike:
        """What the sensors give now."""

    def heat(self, joint: int, celsius: float) -> None:
        """Warm a joint up by so much."""

    def block(self, joint: int) -> None:
        """Jam a joint."""
