"""A permission that is given at once, for sessions whose motion needs no check of its surroundings."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from daq.motion.trajectories import Motion, slow_move
from daq.robot.schema import Robot
from drivers.core.arrays import FloatArray

if TYPE_CHECKING:
    from daq.session.play import Play


class Unchecked:
    """Implements daq.session.play.Permission."""

    def __init__(self, motion: Motion, robot: Robot) -> None:
        self._start = motion.evaluate(np.zeros(1))[0][:, 0]
        self._limits = robot.joints

    def approach(self, position: FloatArray) -> Motion:
        return slow_move(position, self._start, self._limits)

    def ask(self) -> None:
        pass

    def answer(self) -> bool:
        return True


def unchecked_play(motion: Motion, robot: Robot) -> Play:
    """What a session plays without asking."""
    from daq.session.play import Play

    return Play(motion, robot, Unchecked(motion, robot))
