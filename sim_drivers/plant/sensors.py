"""Sensors of a simulated arm: quantisation, noise, ripple, delay."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from daq.robot.schema import Robot
from drivers.core.arrays import FloatArray


@dataclass(frozen=True)
class Measurement:
    """One sample of everything that the arm reports; arrays are (n,), in the robot file's order."""

    time: float  # of the arm's clock [s]
    position: FloatArray  # encoder [rad or m]
    velocity: FloatArray  # filtered difference of the encoder [rad/s or m/s]
    current: FloatArray  # motor signal, torque over gain, sign included [A]; the torque where the gain is unknown
    torque: FloatArray  # of the drive, joint side [N·m]
    temperature: FloatArray  # of the housing [°C]
    # target_position, target_velocity, target_acceleration: the controller's reference
    target_position: FloatArray
    target_velocity: FloatArray
    target_acceleration: FloatArray
    target_current: FloatArray  # motor signal commanded by the controller
    model_torque: Callable[[], FloatArray]  # computes `target_torque`, which few ask for

    @cached_property
    def target_torque(self) -> FloatArray:
        """Torque of the target's motion without friction (n,) [N·m]."""
        return self.model_torque()


def quantised(values: FloatArray, resolution: float) -> FloatArray:
    """Values rounded to multiples of `resolution`; unchanged where that is 0."""
    return np.asarray(np.rint(values / resolution) * resolution) if resolution > 0 else values


def drive_gains(robot: Robot) -> FloatArray:
    """Joint torque over motor signal (n,) [N·m/A], sign included; 1 where the file does not state it."""
    return np.array([1.0 if (gain := robot.drive(name).gain) is None else gain for name in robot.joint_names])


class EncoderSpeed:
    """Velocity in a drive: the difference of encoder positions through a first-order low-pass.

    Positions (n,) come once a period [s]; the low-pass has a time constant [s].
    """

    def __init__(self, position: FloatArray, period: float, time_constant: float) -> None:
        self._position = position
        self._period = period
        self._share = 1.0 - float(np.exp(-period / time_constant)) if time_constant > 0 else 1.0
        self.velocity = np.zeros(len(position))

    def add(self, position: FloatArray) -> FloatArray:
        """The velocity (n,) after one more encoder position (n,)."""
        difference = (position - self._position) / self._period
        self._position = position
        self.velocity = self.velocity + self._share * (difference - self.velocity)
        return self.velocity


class TorqueSensor:
    """Drive torque with white noise and a ripple that follows the joint's angle, some steps [s] late.

    The robot's truth has their sizes.
    """

    def __init__(self, robot: Robot, step: float, generator: np.random.Generator) -> None:
        noise = robot.truth.noise
        self._generator = generator
        self._std = np.array([noise.torque_std.get(name, 0.0) for name in robot.joint_names])
        self._amplitude = np.array([noise.ripple_amplitude.get(name, 0.0) for name in robot.joint_names])
        self._frequency = noise.ripple_per_revolution
        self._phase = generator.uniform(0.0, 2.0 * np.pi, robot.dof)
        self.delayed_steps = round(noise.torque_delay / step)
        self._history: deque[tuple[FloatArray, FloatArray]] = deque(maxlen=self.delayed_steps + 1)

    def push(self, torque: FloatArray, position: FloatArray) -> None:
        """The true drive torque and position (n,) of the next step."""
        self._history.append((torque, position))

    def read(self) -> FloatArray:
        """The measured torque (n,) [N·m]; each call draws its own noise."""
        torque, position = self._history[0]
        ripple = self._amplitude * np.sin(self._frequency * position + self._phase)
        return np.asarray(torque + ripple + self._std * self._generator.standard_normal(len(torque)))
