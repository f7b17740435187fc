"""Permission to move: the approach to the start pose is checked, and a person confirms it."""

from __future__ import annotations

from typing import Protocol

from daq.motion.trajectories import Motion
from drivers.core.arrays import FloatArray


class Permission(Protocol):
    """Permission that a session requests before it moves an arm; it must not block."""

    def approach(self, position: FloatArray) -> Motion:
        """The checked approach from a position (n,) [rad or m] to the start of the motion.

        Raises:
            MotionRefusedError: there is none.
        """

    def ask(self) -> None:
        """Ask whether the arm may make the approach and then play the motion."""

    def answer(self) -> bool | None:
        """The answer; None until there is one."""
