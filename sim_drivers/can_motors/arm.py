"""The plant behind simulated CAN motors: springs and dampers that commands set, which act on an arm of servos."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daq.robot.loader import RobotFile
from drivers.can_motors.settings import CanMotor
from drivers.core.arrays import FloatArray
from sim_drivers.plant.clocked_arm import ClockedArm
from sim_drivers.plant.servo import true_servos

NOMINAL_VOLTAGE = 24.0
"""[V] of a supply that the truth does not name."""


@dataclass(frozen=True)
class Command:
    """What a motor is to do; of the motor."""

    goal: float  # of its spring [rad]
    speed: float = 0.0  # by which the goal moves on [rad/s]
    stop: float = math.nan  # where that ends [rad]; nan for nowhere
    torque: float = 0.0  # beside spring and damper [N·m]


class MotorPlant(ClockedArm):
    """An arm of motors, in the joints' order, in the time of a clock; it stands at `position` (n,) [rad] at first."""

    def __init__(self, file: RobotFile, motors: Sequence[CanMotor], position: FloatArray, now: float) -> None:
        super().__init__(file, position, now, NOMINAL_VOLTAGE)
        truth = true_servos(file.robot, file.where)
        self._motors = motors
        self._delay = [servo.delay for servo in truth]
        self._truth = [(servo.stiffness, servo.gain_d) for servo in truth]
        self._limit = np.array([servo.torque_limit for servo in truth])
        self._most = self._limit.copy()
        self._coming: list[deque[tuple[float, Command, float, float]]] = [deque() for _ in motors]
        self._goal = position.copy()
        self._speed, self._pushing = np.zeros((2, len(position)))
        self._until = np.full(len(position), np.nan)
        self._kp, self._kd = np.zeros((2, len(position)))
        self._now = now
        self._sensed: dict[int, dict[str, float]] = {}
        self.arm.effort = np.full(len(position), np.inf)  # of a servo's spring alone; a motor's limit is kept here
        self._drive(position)

    def command(
        self,
        index: int,
        now: float,
        command: Command,
        gains: tuple[float, float] | None,
        shares: tuple[float, float] = (1.0, 1.0),
    ) -> None:
        """A motor has a command with kp and kd, or with shares of those of the truth; it takes effect later."""
        motor = self._motors[index]
        own = self._truth[index] if gains is None else np.array(gains) * motor.ratio**2
        stiffness, damping = own[0] * shares[0], own[1] * shares[1]
        of_joint = Command(
            motor.to_joint("position", command.goal),
            motor.to_joint("velocity", command.speed),
            motor.to_joint("position", command.stop),
            motor.to_joint("torque", command.torque),
        )
        self._coming[index].append((now + self._delay[index], of_joint, float(stiffness), float(damping)))

    def limit(self, index: int, torque: float | None) -> None:
        """A motor keeps a torque limit [N·m of the motor]; its own where None."""
        own = self._limit[index]
        self._most[index] = own if torque is None else min(own, torque * self._motors[index].ratio)
        self._sensed.clear()

    def let_go(self, index: int) -> None:
        """A motor drives no more."""
        self._coming[index].clear()
        self._kp[index] = self._kd[index] = self._pushing[index] = self._speed[index] = 0.0
        self._sensed.clear()

    def advance(self, now: float) -> None:
        """Simulate until a time [s]."""
        self._now = now
        self._sensed.clear()
        super().advance(now)

    def measured(self, index: int) -> dict[str, float]:
        """Return what a motor's own sensors hold: its position, velocity, torque, temperatures and supply."""
        if index not in self._sensed:
            self._sensed[index] = self._sense(index)
        return self._sensed[index]

    def _goals(self, step: float) -> FloatArray:
        before, driving = self._goal.copy(), self._kp > 0.0
        share = np.ones(len(before))  # of the step, in which the newest goal acts
        for index, coming in enumerate(self._coming):
            while coming and coming[0][0] <= self._time:
                since, command, self._kp[index], self._kd[index] = coming.popleft()
                self._goal[index] = command.goal + command.speed * (self._time - step - since)
                self._speed[index], self._until[index] = command.speed, command.stop
                self._pushing[index] = command.torque
                share[index] = min((self._time - since) / step, 1.0) if driving[index] else 1.0
        self._move_goals(step)
        acting = self._goal - 0.5 * step * self._speed
        goal: FloatArray = before + share * (acting - before)
        self._drive(goal)
        return goal

    def _sense(self, index: int) -> dict[str, float]:
        motor, ratio = self._motors[index], self._motors[index].ratio
        v = float(self.arm.velocity[index])
        # The arm is up to a whole step behind the clock's time; a motor's sensors are not.
        q = float(self.arm.position[index]) + v * (self._now - self._time)
        speed = float(self._speed[index])
        goal = float(self._goal[index]) + speed * (self._now - self._time)
        asked = float(self._kp[index]) * (goal - q) + float(self._kd[index]) * (speed - v) + float(self._pushing[index])
        most = float(self._strongest()[index])
        torque = min(max(asked, -most), most)
        return {
            "position": motor.goal(q),
            "velocity": motor.direction * ratio * v,
            "torque": motor.direction * torque / ratio,
            "temperature": float(self.arm.heat.winding[index]),
            "drive_temperature": float(self.arm.heat.housing[index]),
            "supply_voltage": self._nominal * self.arm.supply * self.left,
        }

    def _move_goals(self, step: float) -> None:
        """Goals that move on, until they are where they stop."""
        after = self._goal + self._speed * step
        over = (after - self._until) * np.sign(self._speed) >= 0.0
        self._goal = np.where(over, self._until, after)
        self._speed[over] = 0.0

    def _drive(self, goal: FloatArray) -> None:
        """Springs to goals (n,), dampers and torques of their own for a step; a limit cuts their sum."""
        push = self._kd * self._speed + self._pushing
        asked = self._kp * (goal - self.arm.position) - self._kd * self.arm.velocity + push
        most = self._strongest()
        over = np.abs(asked) > most
        self.arm.set_gains(np.where(over, 0.0, self._kp), np.where(over, 0.0, self._kd))
        self.arm.push = np.where(over, np.copysign(most, asked), push)

    def _strongest(self) -> FloatArray:
        """Torque (n,) at most [N·m of the joints]."""
        return self._most * self.left
