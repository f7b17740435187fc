"""The way from where an arm is to where a motion begins."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from daq.motion.limits import check_limits
from daq.motion.motion_check import MotionCheck, MotionFigures
from daq.motion.trajectories import Motion, Pieces, PointToPoint, slow_move
from daq.robot.schema import JointLimits
from drivers.core.arrays import FloatArray
from drivers.core.errors import MotionRefusedError, UsageError

_SAME = 1e-3
"""A joint that is as near as this to its start [rad or m] is not moved on its own."""


def approaches(position: FloatArray, start: FloatArray, limits: Sequence[JointLimits]) -> Iterator[PointToPoint]:
    """Slow ways between two positions (n,): straight, then with some joints first and the others after them."""
    yield slow_move(position, start, limits)
    far = np.flatnonzero(np.abs(start - position) > _SAME)
    for count in range(1, len(far)):
        for first in combinations(far, count):
            corner = position.copy()
            corner[list(first)] = start[list(first)]
            moves = (slow_move(position, corner, limits), slow_move(corner, start, limits))
            yield PointToPoint(np.array([position, corner, start]), np.array([move.duration for move in moves]))


def checked_approach(
    position: FloatArray, start: FloatArray, limits: Sequence[JointLimits], check: MotionCheck
) -> tuple[PointToPoint, MotionFigures]:
    """The first of these ways from where the arm is to where it is to go (n,) [rad or m] that passes the check.

    Raises:
        MotionRefusedError: none does; says what is wrong with the straight one.
    """
    refusal: UsageError | MotionRefusedError | None = None
    for way in approaches(position, start, limits):
        try:
            check_limits(way, limits, "the approach to the start pose")
            return way, check.approach(way)
        except (UsageError, MotionRefusedError) as error:
            refusal = refusal or error
    assert refusal is not None
    raise MotionRefusedError(
        refusal.message, where=refusal.where, hint="move the arm nearer to the start pose with its own controller"
    )


@dataclass(frozen=True)
class TimeScaled:
    """A motion slowed down in time: velocities are multiplied by `scale`, accelerations by its square."""

    motion: Motion  # at full speed
    scale: float  # share of its speed, above 0 and at most 1

    def __post_init__(self) -> None:
        """Refuse a scale that would speed the motion up."""
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
