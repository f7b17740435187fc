"""The plant behind simulated servos: goals arrive late, profiles follow them, the arm follows the profiles."""

from __future__ import annotations

from collections import deque

import numpy as np

from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from drivers.core.units import TURN
from sim_drivers.plant.clocked_arm import ClockedArm
from sim_drivers.plant.servo import true_servos
from sim_drivers.serial_servos.motor import SimulatedServo

STALL_CURRENT = 2.7
"""[A] of a servo at its torque limit where the truth names none: an STS3215 at 12 V, Feetech's data sheet."""
NOMINAL_VOLTAGE = 12.0
"""[V] of a supply that the truth does not name."""


class ServoPlant(ClockedArm):
    """An arm of servos, in the joints' order, in the time of a clock; it stands at `position` (n,) [rad] at first."""

    def __init__(
        self, file: RobotFile, servos: list[SimulatedServo], position: FloatArray, now: float, seed: int = 0
    ) -> None:
        super().__init__(file, position, now, NOMINAL_VOLTAGE)
        truth = true_servos(file.robot, file.where)
        self._servos = servos
        self._delay, self._jitter = ([getattr(servo, name) for servo in truth] for name in ("delay", "jitter"))
        self._profile = np.array([servo.acceleration for servo in truth])
        self._torque_limit = np.array([servo.torque_limit for servo in truth])
        self._stall = np.array([servo.stall_current or STALL_CURRENT for servo in truth])
        self._coming: list[deque[tuple[float, float]]] = [deque() for _ in servos]
        self._target, self._goal = position.copy(), position.copy()
        self._pace = np.zeros(len(position))
        self._random = np.random.default_rng([seed, 1])
        self.changed()
        self.report()

    def take_goal(self, index: int, now: float) -> None:
        """The servo of a joint has a goal, in its register; it takes effect later."""
        servo = self._servos[index]
        goal = servo.motor.scale.position(servo.get("goal_position"))
        late = self._delay[index] + self._jitter[index] * self._random.uniform()
        self._coming[index].append((now + late, goal))

    def changed(self) -> None:
        """Registers that limit the motion may have changed."""

        def limit(servo: SimulatedServo, name: str) -> float:
            held = servo.get(name) * servo.table.registers[name].scale if servo.holds(name) else 0.0
            return held if held > 0.0 else np.inf

        self._accelerations = np.minimum([limit(servo, "acceleration") for servo in self._servos], self._profile)
        self._speeds = np.array([limit(servo, "speed_limit") for servo in self._servos])
        self._efforts = np.array([servo.effort for servo in self._servos])

    def report(self) -> None:
        """Let the registers show the arm as it is."""
        position, velocity = self.arm.position.tolist(), self.arm.velocity.tolist()
        share = self.arm.torque / self._torque_limit
        current = np.abs(share) * self._stall
        volts = self._nominal * self.arm.supply * self.left
        for index, servo in enumerate(self._servos):
            scale, registers = servo.motor.scale, servo.table.registers
            turning = scale.direction * TURN / servo.table.steps / scale.step
            servo.put("present_position", scale.steps(position[index]))
            shown = {
                "present_velocity": velocity[index] * turning,
                "present_load": share[index] * scale.direction,
                "present_pwm": share[index] * scale.direction,
                "present_current": current[index] * (np.sign(share[index]) * scale.direction if servo.signed else 1.0),
                "present_voltage": volts,
                "present_temperature": self.arm.heat.housing[index],
            }
            for name, value in shown.items():
                if name in registers:
                    servo.put(name, round(float(value) / registers[name].scale))
            servo.put("status", servo.errors)

    def _goals(self, step: float) -> FloatArray:
        for index, coming in enumerate(self._coming):
            while coming and coming[0][0] <= self._time:
                self._target[index] = coming.popleft()[1]
        limp = self._efforts == 0.0
        if limp.any():  # what a limp servo aims at is where it is when it is switched on
            self._goal[limp] = self._target[limp] = self.arm.position[limp]
            self._pace[limp] = 0.0
        most = self._accelerations * step
        away = self._target - self._goal
        distance = np.abs(away)
        speed = np.sqrt(2.0 * self._accelerations * distance + most**2 / 4.0) - most / 2.0
        speed = np.minimum(np.minimum(speed, distance / step), self._speeds)
        self._pace = np.clip(np.sign(away) * speed, self._pace - most, self._pace + most)
        self._goal = self._goal + step * self._pace
        self.arm.effort = self._efforts * self.left
        return self._goal
