"""An arm of servos in the time of a clock: what simulated serial servos and CAN motors have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from sim_drivers.plant.servo import ServoArm

SAGGING = 0.5
"""Share of its voltage that a sagging supply has left."""
BEHIND_LIMIT = 0.05
"""[rad] from a joint's position limit to its end stop."""
LONGEST_ADVANCE = 0.25
"""[s]: a stall of more is not made up for: the arm's time is halted meanwhile."""
POWER_UP = 0.4
"""[s] that a servo or motor needs after its power came back."""


class ClockedArm(ABC):
    """Advances an arm with the goals that `_goals` gives for each step.

    The file's truth has a servo for every joint; the arm stands at `position` (n,) [rad] at first. A supply that the
    truth does not name has the nominal voltage [V].

    Attributes:
        arm: the bodies.
        sagging: whether the supply's voltage is low.
        stalls: times when the arm's time fell behind the clock.
    """

    def __init__(self, file: RobotFile, position: FloatArray, now: float, nominal: float) -> None:
        self.arm = ServoArm(file, position.copy())
        self.sagging = False
        self.stalls = 0
        supply = file.robot.truth.supply
        self._nominal = nominal if supply is None else supply.nominal
        self._time = now
        low, high = np.array([joint.position for joint in file.robot.joints]).T
        self._stops = low - BEHIND_LIMIT, high + BEHIND_LIMIT

    @abstractmethod
    def _goals(self, step: float) -> FloatArray:
        """Goals (n,) of the position loops [rad] for a step [s] that ends now."""

    @property
    def left(self) -> float:
        """Share of the supply's voltage that a sag leaves."""
        return SAGGING if self.sagging else 1.0

    def advance(self, now: float) -> None:
        """Simulate until a time [s]."""
        if now - self._time > LONGEST_ADVANCE:
            self._time = now - LONGEST_ADVANCE
            self.stalls += 1
        step = self.arm.step
        while self._time + step <= now:
            self._time += step
            self.arm.advance(self._goals(step))
            self.arm.keep_within(*self._stops)

    def heat(self, joint: int, celsius: float) -> None:
        """Warm winding and housing of a joint up [K]."""
        self.arm.heat.winding[joint] += celsius
        self.arm.heat.housing[joint] += celsius


def start_position(file: RobotFile, position: FloatArray | None) -> FloatArray:
    """Return where an arm stands at first (n,) [rad]; in the middle of the joints' ranges where None."""
    return np.array([0.5 * sum(joint.position) for joint in file.robot.joints]) if position is None else position
