"""Moves from point to point as a family of motions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from daq.motion.trajectories import QUINTIC_ACCELERATION, QUINTIC_VELOCITY, Motion, PointToPoint
from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from ident.excite.families.moving_joints import (
    LARGEST_SHARE,
    LEAST_SHARE,
    Family,
    check_count,
    check_positive,
    from_share,
    midrange,
    to_share,
)
from ident.excite.path import JointPath

_ORDER = 8
"""Order of the power mean that smooths the maximum of the joints' times; even, and half of it too."""
_SHORTEST_SHARE = 0.2
"""Time of a move over no distance, as a share of the mean."""
_FITTINGS = 30


@dataclass(frozen=True)
class _Moves:
    """Move of each time (N,), how far it is, and the polynomial with its derivatives by u there."""

    index: np.typing.NDArray[np.intp]
    u: FloatArray
    length: FloatArray  # of that move [s]
    shape: tuple[FloatArray, FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True, eq=False)
class PointsFamily(Family):
    """Fifth-order moves between points (SR400 .4.3), at rest in each, all in a given time.

    x holds the points (P, joints that move): each coordinate lies at sin(x) of half the joint's range (of a turn where
    the range has no end) from its middle. The moves share the time in proportion to what they need: the least time
    that keeps every joint's velocity and acceleration limit, by a power mean of order 8 over joints and limits in place
    of the maximum. So all moves use about the same share of the limits and the durations follow smoothly from the
    points. The grid is uniform in time: a rest of `dwell` weighs in a design what it weighs in the recording.

    Raises:
        UsageError: no joint moves, a number is not possible, or the rests leave no time for moves.
    """

    duration: float  # of all moves and rests [s]
    points: int  # their number P
    dwell: float = 0.0  # rest in every point but the first [s]

    def __post_init__(self) -> None:
        check_positive("duration", self.duration)
        check_count("points", self.points, 2)
        if not 0.0 <= self.dwell < np.inf:
            raise UsageError(f"a rest of {self.dwell:g} s is not possible")
        if not self._available > 0.0:
            raise UsageError(
                f"{self.points - 1} rests of {self.dwell:g} s leave no time to move in {self.duration:g} s"
            )

    @property
    def size(self) -> int:
        """Number of decision variables: P for each joint that moves."""
        return self.points * self.joints.count

    def grid(self, count: int) -> FloatArray:
        """`count` times (count,) [s] from begin to end."""
        return np.linspace(0.0, self.duration, max(count, 2))

    def durations(self, points: FloatArray) -> FloatArray:
        """Times (P − 1,) of the moves [s] between points (P, m)."""
        need, _ = self._needs(np.diff(points, axis=0))
        return np.asarray(self._available * need / need.sum())

    def path(self, variables: FloatArray, time: FloatArray) -> JointPath:
        """The moves at times (N,) within the duration."""
        points = self._points(variables)
        return self.joints.path(time, *PointToPoint(points, self.durations(points), self.dwell).evaluate(time))

    def pull_back(self, variables: FloatArray, time: FloatArray, gradient: FloatArray) -> FloatArray:
        """Implement `Family`; the durations are differentiated too."""
        points = self._points(variables)
        ways = np.diff(points, axis=0)
        need, need_by_way = self._needs(ways)
        moves = self._moves(self._available * need / need.sum(), time)
        p, p1, p2, p3 = moves.shape
        length, u = moves.length, moves.u
        of_moving = gradient[..., self.joints.rows, :]

        inside = np.zeros((self.points - 1, time.size))
        inside[moves.index, np.arange(time.size)] = 1.0
        # ∂/∂way; the start of a move adds to the position alone.
        by_way = sum(
            (of_moving[..., order, :, :] * factor) @ inside.T
            for order, factor in enumerate((p, p1 / length, p2 / length**2))
        )
        by_start = of_moving[..., 0, :, :] @ inside.T  # (..., m, P − 1)

        # ∂/∂ of a move's own time and of when it begins, each summed over joints.
        way = ways[moves.index].T
        in_time = [-way * p1 * u / length, -way * (p2 * u + p1) / length**2, -way * (p3 * u + 2.0 * p2) / length**3]
        in_begin = [-way * p1 / length, -way * p2 / length**2, -way * p3 / length**3]
        by_time = np.einsum("...cmt,cmt->...t", of_moving, np.array(in_time)) @ inside.T
        by_begin = np.einsum("...cmt,cmt->...t", of_moving, np.array(in_begin)) @ inside.T
        # A move begins later by what all those before it take longer.
        later = np.cumsum(by_begin[..., ::-1], axis=-1)[..., ::-1] - by_begin
        by_time = by_time + later
        total = need.sum()
        by_need = self._available / total * (by_time - (by_time @ need / total)[..., None])
        by_way = by_way + (by_need[..., None] * need_by_way).swapaxes(-1, -2)

        by_point = np.zeros((*gradient.shape[:-3], self.points, self.joints.count))
        by_way, by_start = by_way.swapaxes(-1, -2), by_start.swapaxes(-1, -2)
        by_point[..., :-1, :] += by_start - by_way
        by_point[..., 1:, :] += by_way
        slope = self._half * np.cos(variables.reshape(self.points, -1))
        return (by_point * slope).reshape(*gradient.shape[:-3], self.size)

    def random(self, generator: np.random.Generator) -> FloatArray:
        """A random x within the limits: each joint uses a random share of its tightest one, of its range a turn.

        Shares of moves that hang together through their common durations are met by repeated scaling.
        """
        points = self.joints.half * generator.uniform(-1.0, 1.0, (self.points, self.joints.count))
        wanted = generator.uniform(LEAST_SHARE, LARGEST_SHARE, self.joints.count)
        for _ in range(_FITTINGS):
            points = points * (wanted / self._uses(points))
        while float(self._uses(points).max()) > LARGEST_SHARE:
            points = 0.95 * points
        lowest, highest = points.min(axis=0), points.max(axis=0)
        room = self.joints.half - 0.5 * (highest - lowest)
        shift = self.joints.middle - 0.5 * (highest + lowest)
        return self._variables(points + shift + generator.uniform(-0.5, 0.5, self.joints.count) * room)

    def motion(self, variables: FloatArray) -> Motion:
        """The motion as played, from rest to rest."""
        return PointToPoint(*self._whole(variables), self.dwell)

    def encode(self, motion: Motion) -> FloatArray:
        """The x of an earlier motion's points; its durations and rests do not matter, for they follow from the points.

        A coordinate at an end of its range is moved inwards a little, as `from_share` says.

        Raises:
            UsageError: another kind of motion, number of points or set of joints, or a point out of the range.
        """
        if not isinstance(motion, PointToPoint):
            raise UsageError("the earlier motion has no points", hint="--kind must be that of the file")
        index, joints = motion.points.shape
        if index != self.points:
            raise UsageError(f"the earlier motion has {index} points, not {self.points}", hint=f"--points {index}")
        self.joints.check_same(joints, motion.points[0], np.abs(motion.points - motion.points[0]).max(axis=0))
        points = motion.points[:, self.joints.rows]
        outside = np.argwhere(np.abs(points - self.joints.middle) > self._half * (1.0 + 1e-9))
        if len(outside):
            point, joint = outside[0]
            limits = self.joints.limits[self.joints.moving[joint]]
            raise UsageError(
                f"point {point} of the earlier motion has joint {limits.name} at "
                f"{points[point, joint]:.5g} {limits.unit('rad')}, out of its range"
            )
        return self._variables(points)

    def middle(self, variables: FloatArray) -> FloatArray:
        """Middle (m,) of the range of each moving joint's motion [rad or m]."""
        return midrange(self._points(variables).T)

    def about(self, variables: FloatArray, pose: FloatArray, share: float) -> FloatArray:
        """Implement `Family`; the durations follow. Points are kept within the joints' ranges."""
        points = self._points(variables)
        return self._variables(pose + share * (points - midrange(points.T)))

    @property
    def _available(self) -> float:
        return self.duration - (self.points - 1) * self.dwell

    @cached_property
    def _half(self) -> FloatArray:
        """Half of the whole ranges (m,); of a turn where one has no end."""
        ranges = [self.joints.limits[joint].position for joint in self.joints.moving]
        widths = np.array([high - low for low, high in ranges])
        return np.where(np.isfinite(widths), 0.5 * widths, self.joints.half)

    def _points(self, variables: FloatArray) -> FloatArray:
        """(P, m)."""
        return self.joints.middle + self._half * to_share(variables.reshape(self.points, -1))

    def _variables(self, points: FloatArray) -> FloatArray:
        return from_share((points - self.joints.middle) / self._half).ravel()

    def _whole(self, variables: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points (P, n) of all joints and durations (P − 1,)."""
        points = self._points(variables)
        return self.joints.whole(points.T, self.joints.rest).T, self.durations(points)

    def _needs(self, ways: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Times (P − 1,) that moves of ways (P − 1, m) need [s], and their derivatives (P − 1, m) by the ways."""
        # Whole powers of the ways, so that there is no kink where a joint stays.
        half_order = _ORDER // 2
        mean = self._available / (self.points - 1)
        by_speed = (QUINTIC_VELOCITY / self.joints.velocity / mean) ** _ORDER
        by_change = (QUINTIC_ACCELERATION / self.joints.acceleration / mean**2) ** half_order
        total = (by_speed * ways**_ORDER + by_change * ways**half_order).sum(axis=1) + _SHORTEST_SHARE**_ORDER
        need = total ** (1.0 / _ORDER)
        slope = by_speed * ways ** (_ORDER - 1) + 0.5 * by_change * ways ** (half_order - 1)
        return mean * need, mean * slope * (need / total)[:, None]

    def _moves(self, durations: FloatArray, time: FloatArray) -> _Moves:
        starts = np.concatenate([[0.0], np.cumsum(durations + self.dwell)])
        index = np.clip(np.searchsorted(starts, time, side="right") - 1, 0, len(durations) - 1)
        length = durations[index]
        u = np.clip((time - starts[index]) / length, 0.0, 1.0)
        v = 1.0 - u
        # At u = 1 the third derivative jumps from 60 to 0, the value of the rest that follows.
        shape = (
            u**3 * (10.0 - 15.0 * u + 6.0 * u**2),
            30.0 * (u * v) ** 2,
            60.0 * u * v * (v - u),
            np.where(u < 1.0, 60.0 * (1.0 - 6.0 * u * v), 0.0),
        )
        return _Moves(index, u, length, shape)

    def _uses(self, points: FloatArray) -> FloatArray:
        """Use (m,) of each joint's tightest limit by points (P, m), of its range at most one turn."""
        times = self.durations(points)[:, None]
        ways = np.abs(np.diff(points, axis=0))
        uses = np.max(
            [
                np.ptp(points, axis=0) / (2.0 * self.joints.half),
                (QUINTIC_VELOCITY * ways / times).max(axis=0) / self.joints.velocity,
                (QUINTIC_ACCELERATION * ways / times**2).max(axis=0) / self.joints.acceleration,
            ],
            axis=0,
        )
        return np.asarray(uses)
