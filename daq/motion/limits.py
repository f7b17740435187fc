"""Tells whether a motion keeps the limits of its joints at every time, not on a grid alone: its extremes, enclosed.

Within an interval of width w a function exceeds the larger of its values at both ends by no more than w/2 times a
bound of its first derivative, and by no more than w²/8 times one of its second (the error of linear interpolation).
Intervals whose bound passes both the limit and the largest value found so far are divided, until none is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daq.motion.trajectories import Motion, Pieces
from daq.robot.schema import JointLimits
from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError

LIMIT_TOLERANCE = 1e-9
_SHARPNESS = 1e-10
"""An extreme is enclosed as narrowly as this, absolutely or as a share of it."""
_BATCH = 4096
"""Intervals that are evaluated at once, about."""
_MOST = 1_000_000
"""Times that are evaluated in all, and four for each piece; what is undecided then counts with its bound."""


@dataclass(frozen=True)
class Extremes:
    """The extremes of a motion; rows are −position, position, |velocity| and |acceleration|, columns are joints."""

    found: FloatArray  # (4, n) largest value found
    bound: FloatArray  # (4, n) that no value of the motion exceeds; 1e-10 above, unless the motion is too fast to tell
    times: FloatArray  # (4, n) when it was found [s]

    @property
    def lowest(self) -> FloatArray:
        """(n,) no position is below [rad or m]."""
        return np.asarray(-self.bound[0])

    @property
    def highest(self) -> FloatArray:
        """(n,) no position is above [rad or m]."""
        return np.asarray(self.bound[1])

    @property
    def velocity(self) -> FloatArray:
        """(n,) no velocity exceeds [rad/s or m/s]."""
        return np.asarray(self.bound[2])

    @property
    def acceleration(self) -> FloatArray:
        """(n,) no acceleration exceeds [rad/s² or m/s²]."""
        return np.asarray(self.bound[3])


@dataclass(frozen=True)
class _Intervals:
    """Start and end (M,) [s], the pieces (M,) that they lie in, and what no value in any of them exceeds (4, n)."""

    start: FloatArray
    end: FloatArray
    piece: np.typing.NDArray[np.intp]
    bound: FloatArray


def motion_extremes(motion: Motion, sufficient: FloatArray | None = None) -> Extremes:
    """The extremes of a motion over its duration.

    A bound that is not above `sufficient` (4, n), rows as in `Extremes`, is not narrowed further; None narrows all.
    """
    with np.errstate(all="ignore"):  # a motion may be too fast for floating point; its bound is then infinite
        pieces = motion.pieces()
        shape = (4, pieces.largest.shape[1])
        enough = np.full(shape, -np.inf) if sufficient is None else sufficient
        highest, bound, times = np.full(shape, -np.inf), np.full(shape, -np.inf), np.zeros(shape)
        count, looked = len(pieces.start), 0
        waiting = [
            _Intervals(pieces.start[batch], pieces.end[batch], np.arange(count)[batch], np.full(shape, np.inf))
            for batch in (slice(begin, begin + _BATCH) for begin in range(0, count, _BATCH))
        ]
        while waiting and looked < _MOST + 4 * count:
            intervals = waiting.pop()
            edges, rise = _divided(intervals, pieces)
            values = _values(motion, edges)
            looked += edges.size
            best = values.reshape(*shape, -1).argmax(axis=-1)
            reached = np.take_along_axis(values.reshape(*shape, -1), best[..., None], axis=-1)[..., 0]
            times = np.where(reached > highest, edges.ravel()[best], times)
            highest = np.fmax(highest, reached)
            bounds = np.maximum(values[..., :-1], values[..., 1:]) + rise
            bounds[2:] = np.fmin(bounds[2:], pieces.largest[:2, :, intervals.piece, None])
            narrow = np.maximum(highest + _SHARPNESS * np.maximum(1.0, np.abs(highest)), enough)
            undecided = ~(bounds <= narrow[..., None, None]).all(axis=(0, 1))  # NaN decides nothing
            bound = np.maximum(bound, bounds[..., ~undecided].max(axis=-1, initial=-np.inf))
            for rows in np.array_split(np.argwhere(undecided), np.arange(_BATCH, undecided.sum(), _BATCH)):
                if len(rows):
                    row, column = rows.T
                    largest = bounds[..., row, column].max(axis=-1)
                    piece = intervals.piece[row]
                    waiting.append(_Intervals(edges[row, column], edges[row, column + 1], piece, largest))
        bound = np.array([bound, highest, *(intervals.bound for intervals in waiting)]).max(axis=0)
    return Extremes(highest, np.where(np.isnan(bound), np.inf, bound), times)


def _divided(intervals: _Intervals, pieces: Pieces) -> tuple[FloatArray, FloatArray]:
    """Edges (M, P + 1) [s] of the parts of every interval, and how far (4, n, M, P) their values exceed those there."""
    parts = int(np.clip(_BATCH // len(intervals.start), 2, 64))
    edges = np.linspace(intervals.start, intervals.end, parts + 1, axis=1)
    width = np.diff(edges, axis=1)
    slope = pieces.largest[[0, 0, 1, 2]][:, :, intervals.piece, None]
    curvature = pieces.largest[[1, 1, 2, 3]][:, :, intervals.piece, None]
    return edges, np.fmin(0.5 * width * slope, 0.125 * width**2 * curvature)


def _values(motion: Motion, time: FloatArray) -> FloatArray:
    """(4, n, *time.shape) rows as in `Extremes`."""
    position, velocity, acceleration = motion.evaluate(time.ravel())
    values = np.array([-position, position, np.abs(velocity), np.abs(acceleration)])
    return values.reshape(*values.shape[:2], *time.shape)


def check_limits(motion: Motion, limits: Sequence[JointLimits], where: str) -> None:
    """Refuse a motion that leaves a joint's range or exceeds its velocity or acceleration limit, at any time.

    Raises:
        UsageError: names the joint, the value, the limit and the time.
    """
    with np.errstate(all="ignore"):
        joints = len(motion.evaluate(np.zeros(1))[0])
    if joints != len(limits):
        raise UsageError(f"moves {joints} joints, but the robot has {len(limits)}", where=where)
    rows = [(-limit.position[0], limit.position[1], limit.velocity, limit.acceleration) for limit in limits]
    allowed = np.array(rows).T
    enough = allowed + LIMIT_TOLERANCE * np.maximum(1.0, np.abs(allowed))
    extremes = motion_extremes(motion, enough)
    for joint, limit in enumerate(limits):
        for row, (quantity, unit, sign) in enumerate(_ROWS):
            if extremes.bound[row, joint] <= enough[row, joint]:
                continue
            exceeded = extremes.found[row, joint] > enough[row, joint]
            value = (extremes.found if exceeded else extremes.bound)[row, joint]
            seen = f"{sign * value:.5g} at" if exceeded else f"may reach {sign * value:.5g} near"
            raise UsageError(
                f"joint {limit.name}: {quantity} {seen} {extremes.times[row, joint]:.3f} s "
                f"passes its limit of {sign * allowed[row, joint]:.5g} {limit.unit(unit)}",
                where=where,
                hint="reduce the amplitude or slow down the motion",
            )


_ROWS = (
    ("position", "rad", -1.0),
    ("position", "rad", 1.0),
    ("velocity", "rad/s", 1.0),
    ("acceleration", "rad/s²", 1.0),
)


def check_rest(motion: Motion, limits: Sequence[JointLimits], where: str) -> None:
    """Refuse a motion that does not begin and end at rest (velocity below 0.1 % of the limit).

    Raises:
        UsageError: names the joint and the velocity.
    """
    _, velocity, _ = motion.evaluate(np.array([0.0, motion.duration]))
    for joint, limit in enumerate(limits):
        for moment, value in zip(("begins", "ends"), velocity[joint], strict=True):
            if not abs(value) <= 1e-3 * limit.velocity:
                speed = f"{value:.4g} {limit.unit('rad/s')}"
                raise UsageError(f"{moment} with joint {limit.name} at {speed}, not at rest", where=where)
