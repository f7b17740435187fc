"""The way from where an arm is to where a motion begins."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from daq.motion.limits import check_limits
from daq.motion.motion_check import MotionCheck, MotionFigures
from daq.motion.trajectories import PointToPoint, slow_move
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
    """The first of these ways that passes the check.

    Args:
        position: where the arm is (n,) [rad or m].
        start: where it is to go (n,) [rad or m].
        limits: of the joints.
        check: of the arm.

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
        refusal.message, where=refusal.where, hint="bring the arm nearer to the start pose by its own means"
    )
