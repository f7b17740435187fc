"""A motion that is played more slowly along its own path."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daq.motion.trajectories import Motion, Pieces
from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError


@dataclass(frozen=True)
class TimeScaled:
    """A motion stretched in time: velocities are multiplied by `scale`, accelerations by its square.

    Attributes:
        motion: at full speed.
        scale: share of its speed, above 0 and at most 1.
    """

    motion: Motion
    scale: float

    def __post_init__(self) -> None:
        """Refuse a scale that would speed the motion up.

        Raises:
            UsageError: the scale is not above 0 and at most 1.
        """
        if not 0.0 < self.scale <= 1.0:
            raise UsageError(f"a speed scale of {self.scale:g} is not above 0 and at most 1")

    @property
    def duration(self) -> float:
        """[s]."""
        return self.motion.duration / self.scale

    def evaluate(self, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position, velocity, acceleration (n, N) at times (N,) [s]."""
        position, velocity, acceleration = self.motion.evaluate(time * self.scale)
        return position, velocity * self.scale, acceleration * self.scale**2

    def pieces(self) -> Pieces:
        """Those of the motion at full speed, later and slower."""
        pieces = self.motion.pieces()
        slower = self.scale ** np.arange(1, 5)
        return Pieces(pieces.start / self.scale, pieces.end / self.scale, pieces.largest * slower[:, None, None])
