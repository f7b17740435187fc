"""Whether an arm may move: the way to the start pose is checked, and a person is asked."""

from __future__ import annotations

from typing import Protocol

from daq.motion.trajectories import Motion
from drivers.streams import FloatArray


class Permission(Protocol):
    """What a session asks before it moves an arm; it must not wait."""

    def approach(self, position: FloatArray) -> Motion:
        """The way from a position (n,) [rad or m] to where the motion begins, checked.

        Raises:
            MotionRefusedError: there is none.
        """

    def ask(self) -> None:
        """Ask whether the arm may take that way and then play the motion."""

    def answer(self) -> bool | None:
        """What was answered; None as long as nothing was."""
