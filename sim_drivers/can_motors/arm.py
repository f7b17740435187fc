"""The plant behind simulated CAN motors: springs and dampers that commands set, which act on an arm of servos."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

from daq.robot.loader import RobotFile
from drivers.can_motors.settings import CanMotor
from drivers.core.arrays import FloatArray
from sim_drivers.plant.servo import ServoArm, true_servos

NOMINAL_VOLTAGE = 24.0
"""[V] of a supply that the truth does not name."""
SAGGING = 0.5
"""Share of its voltage that a sagging supply has left."""
BEHIND_LIMIT = 0.05
"""[rad] from a joint's position limit to its end stop."""
LONGEST_ADVANCE = 0.25
"""[s]: a stall of more is not made up for: the arm's time is halted meanwhile."""


class MotorPlant:
    """An arm of motors in the time of a clock.

    Args:
        file: its truth has a servo for every joint.
        motors: in the joints' order.
        position: (n,) at which it stands at first [rad].
        now: the clock's time [s].

    Attributes:
        arm: the bodies.
        sagging: whether the supply's voltage is low.
        stalls: times when the arm's time fell behind the clock.
    """

    def __init__(self, file: RobotFile, motors: Sequence[CanMotor], position: FloatArray, now: float) -> None:
        truth = true_servos(file.robot, file.where)
        self.arm = ServoArm(file, position.copy())
        self.sagging = False
        self.stalls = 0
        supply = file.robot.truth.supply
        self._nominal = NOMINAL_VOLTAGE if supply is None else supply.nominal
        self._motors = motors
        self._delay = [servo.delay for servo in truth]
        self._truth = [(servo.stiffness, servo.gain_d) for servo in truth]
        self._limit = np.array([servo.torque_limit for servo in truth])
        self._most = self._limit.copy()
        self._coming: list[deque[tuple[float, float, float, float]]] = [deque() for _ in motors]
        self._goal = position.copy()
        self._kp, self._kd = np.zeros((2, len(position)))
        self._time = self._now = now
        low, high = np.array([joint.position for joint in file.robot.joints]).T
        self._stops = low - BEHIND_LIMIT, high + BEHIND_LIMIT
        self.arm.effort = np.zeros(len(position))
        self.arm.set_gains(self._kp.copy(), self._kd.copy())

    def told(self, index: int, now: float, goal: float, gains: tuple[float, float] | None) -> None:
        """A motor has a goal [rad of the motor] with kp and kd, or with those of the truth; it takes effect later."""
        motor = self._motors[index]
        stiffness, damping = self._truth[index] if gains is None else np.array(gains) * motor.ratio**2
        position = motor.to_joint("position", goal)
        self._coming[index].append((now + self._delay[index], position, float(stiffness), float(damping)))

    def limit(self, index: int, torque: float | None) -> None:
        """A motor keeps a torque limit [N·m of the motor]; its own where None."""
        own = self._limit[index]
        self._most[index] = own if torque is None else min(own, torque * self._motors[index].ratio)

    def let_go(self, index: int) -> None:
        """A motor drives no more."""
        self._coming[index].clear()
        self._kp[index] = self._kd[index] = 0.0

    def advance(self, now: float) -> None:
        """Simulate until a time [s]."""
        self._now = now
        if now - self._time > LONGEST_ADVANCE:
            self._time = now - LONGEST_ADVANCE
            self.stalls += 1
        step = self.arm.step
        while self._time + step <= now:
            self._time += step
            for index, coming in enumerate(self._coming):
                while coming and coming[0][0] <= self._time:
                    _, self._goal[index], self._kp[index], self._kd[index] = coming.popleft()
            # A step is implicit: its spring acts as at the end, which damps as if by kp·step/2.
            self.arm.set_gains(self._kp.copy(), np.maximum(self._kd - 0.5 * step * self._kp, 0.0))
            self.arm.effort = self._effort()
            self.arm.advance(self._goal)
            self.arm.keep_within(*self._stops)

    def measured(self, index: int) -> dict[str, float]:
        """What a motor's own sensors hold: its position, velocity, torque, temperatures and supply."""
        motor, ratio = self._motors[index], self._motors[index].ratio
        v = float(self.arm.velocity[index])
        # The arm is up to a whole step behind the clock's time; a motor's sensors are not.
        q = float(self.arm.position[index]) + v * (self._now - self._time)
        most = self._effort()[index] * self._limit[index]
        torque = float(np.clip(self._kp[index] * (self._goal[index] - q), -most, most) - self._kd[index] * v)
        return {
            "position": motor.goal(q),
            "velocity": motor.direction * ratio * v,
            "torque": motor.direction * torque / ratio,
            "temperature": float(self.arm.heat.winding[index]),
            "drive_temperature": float(self.arm.heat.housing[index]),
            "supply_voltage": self._nominal * self.arm.supply * (SAGGING if self.sagging else 1.0),
        }

    def _effort(self) -> FloatArray:
        share: FloatArray = self._most / self._limit * (SAGGING if self.sagging else 1.0)
        return share
