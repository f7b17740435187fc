"""A permission that is given at once, for sessions whose motion needs no check of its surroundings."""

from __future__ import annotations

import numpy as np

from daq.motion.trajectories import slow_move


class Unchecked:
    """Implements daq.session.play.Permission."""

    def __init__(self, motion, robot):
        self._start = motion.evaluate(np.zeros(1))[0][:, 0]
        self._limits = robot.joints

    def approach(self, position):
        return slow_move(position, self._start, self._limits)

    def ask(self):
        pass

    def answer(self):
        return True


def unchecked_play(motion, robot):
    """What a session plays without asking."""
    from daq.session.play import Play

    return Play(motion, robot, Unchecked(motion, robot))
