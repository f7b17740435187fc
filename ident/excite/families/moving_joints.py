"""The moving joints of a motion family with their ranges and speeds, and the rest positions of the others."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from daq.motion.trajectories import SHORTEST_RAMP, Motion, RestToRest
from daq.robot.schema import JointLimits
from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from ident.excite.path import JointPath

_INMOST = 1.0 - 1e-4

ONE_TURN = 2.0 * np.pi
"""Random motions and the variables' scales use no more of a joint's range than this [rad, or m of a slide]."""
_STILL = 1e-9  # [rad or m]
LEAST_SHARE, LARGEST_SHARE = 0.5, 0.95
"""Share of its tightest limit that each joint of a random motion uses."""


def to_share(variables: FloatArray) -> FloatArray:
    """Places between −1 and 1 for any variables: their sine, whose slope is that of the variable in the middle.

    The sine reaches both ends, where it turns back; its slope there vanishes more slowly than that of a sigmoid.
    """
    return np.sin(variables)


def from_share(share: FloatArray) -> FloatArray:
    """Variables between −π/2 and π/2 for places between −1 and 1.

    Places at the very ends are moved inwards by 1e-4, so that a local search sees a slope there.
    """
    return np.arcsin(np.clip(share, -_INMOST, _INMOST))


@dataclass(frozen=True, eq=False)
class MovingJoints:
    """The joints of an arm, split into those that move (m of them) and those that rest.

    Raises:
        UsageError: no joint moves.
    """

    limits: tuple[JointLimits, ...]  # of all n joints; they may be infinite
    moving: tuple[int, ...]  # indices of those that move, ascending
    rest: FloatArray  # (n,) rest positions of the others [rad or m]

    def __post_init__(self) -> None:
        if not self.moving:
            raise UsageError("no joint moves", hint="name at least one with --joints, or leave it out for all")
        if sorted(set(self.moving)) != list(self.moving) or not 0 <= self.moving[0] <= self.moving[-1] < len(self):
            raise ValueError(f"moving joints {self.moving} of {len(self)}")
        if self.rest.shape != (len(self),):
            raise ValueError(f"a rest of shape {self.rest.shape} for {len(self)} joints")

    def __len__(self) -> int:
        return len(self.limits)

    @property
    def count(self) -> int:
        """Return how many move (m)."""
        return len(self.moving)

    @cached_property
    def rows(self) -> list[int]:
        """Indices of those that move, as a list that NumPy takes as an index."""
        return list(self.moving)

    @cached_property
    def velocity(self) -> FloatArray:
        """Limits (m,) [rad/s or m/s]."""
        return np.array([self.limits[joint].velocity for joint in self.moving])

    @cached_property
    def acceleration(self) -> FloatArray:
        """Limits (m,) [rad/s² or m/s²]."""
        return np.array([self.limits[joint].acceleration for joint in self.moving])

    @cached_property
    def middle(self) -> FloatArray:
        """Middle (m,) of the ranges [rad or m]."""
        return np.array([middle_of_range(*self.limits[joint].position) for joint in self.moving])

    @cached_property
    def half(self) -> FloatArray:
        """Half of the ranges (m,), none of them more than one turn [rad or m]."""
        widths = [high - low for low, high in (self.limits[joint].position for joint in self.moving)]
        return 0.5 * np.minimum(widths, ONE_TURN)

    def whole(self, of_moving: FloatArray, of_resting: FloatArray | float) -> FloatArray:
        """Rows (m, ...) of the joints that move among the rows (n, ...) of all."""
        every = np.empty((len(self), *of_moving.shape[1:]))
        every.T[...] = of_resting
        every[self.rows] = of_moving
        return every

    def path(self, time: FloatArray, position: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> JointPath:
        """The path of all joints; positions, velocities and accelerations (m, N) are of those that move."""
        return JointPath(
            time, self.whole(position, self.rest), self.whole(velocity, 0.0), self.whole(acceleration, 0.0)
        )

    def fitted(
        self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray, generator: np.random.Generator
    ) -> tuple[FloatArray, FloatArray]:
        """Factors (m,) and offsets (m,) that put waves (m, N) into the limits.

        Each wave then uses a random share of its tightest limit, of its range at most one turn, and is placed at random
        in the rest of the range.
        """
        lowest, highest = position.min(axis=1), position.max(axis=1)
        uses = [
            (highest - lowest) / (2.0 * self.half),
            np.abs(velocity).max(axis=1) / self.velocity,
            np.abs(acceleration).max(axis=1) / self.acceleration,
        ]
        factor = generator.uniform(LEAST_SHARE, LARGEST_SHARE, self.count) / np.max(uses, axis=0)
        room = self.half - 0.5 * factor * (highest - lowest)
        offset = self.middle - 0.5 * factor * (highest + lowest) + generator.uniform(-0.5, 0.5, self.count) * room
        return factor, offset

    def check_same(self, joints: int, position: FloatArray, travel: FloatArray) -> None:
        """Refuse an earlier motion of other joints, by a position on it and the travel from there (n,) [rad or m].

        Raises:
            UsageError: names the joint that moves, or rests elsewhere.
        """
        if joints != len(self):
            raise UsageError(f"the earlier motion is one of {joints} joints, the robot has {len(self)}")
        for joint in set(range(len(self))) - set(self.moving):
            away = abs(float(position[joint] - self.rest[joint])) + float(travel[joint])
            if not away <= _STILL * max(1.0, abs(float(self.rest[joint]))):
                limits = self.limits[joint]
                raise UsageError(
                    f"joint {limits.name} must stay at {self.rest[joint]:.5g} {limits.unit('rad')}, but it moves or "
                    "rests elsewhere in the earlier motion",
                    hint="let it move, too (--joints)",
                )


@dataclass(frozen=True, eq=False)
class Family(ABC):
    """Motions of one form, given by a vector x of `size` decision variables.

    The variables are scaled to the order of 1 at high limit utilisation.
    """

    joints: MovingJoints  # those that move, and the others

    @property
    @abstractmethod
    def size(self) -> int:
        """Number of decision variables."""

    @abstractmethod
    def grid(self, count: int) -> FloatArray:
        """About `count` times (N,) [s] that cover everything that is played, for designing (not for the last check)."""

    @abstractmethod
    def path(self, variables: FloatArray, time: FloatArray) -> JointPath:
        """The motion of x at times (N,) [s]."""

    @abstractmethod
    def pull_back(self, variables: FloatArray, time: FloatArray, gradient: FloatArray) -> FloatArray:
        """∂/∂x (..., size) of scalars, from their derivatives (..., 3, n, N) by position, velocity and acceleration."""

    @abstractmethod
    def random(self, generator: np.random.Generator) -> FloatArray:
        """A random x that keeps the position, velocity and acceleration limits on the grid."""

    @abstractmethod
    def middle(self, variables: FloatArray) -> FloatArray:
        """Middle (m,) of the range of each moving joint's motion [rad or m]."""

    @abstractmethod
    def about(self, variables: FloatArray, pose: FloatArray, share: float) -> FloatArray:
        """The x of the same motion about another middle (m,) [rad or m], `share` times as large; 0 rests there."""

    @abstractmethod
    def motion(self, variables: FloatArray) -> Motion:
        """The motion as played, from rest to rest."""

    @abstractmethod
    def encode(self, motion: Motion) -> FloatArray:
        """The x of a motion that was designed or written earlier.

        Raises:
            UsageError: it is not of this form; names the difference.
        """

    def begun_near_middle(self, variables: FloatArray) -> FloatArray:
        """The x of the same closed path, begun where it comes nearest to the middle of all joints' ranges.

        An arm is slow on its approach. Unchanged where the path has a fixed beginning.
        """
        return variables

    def with_longer_ramp(self, factor: float) -> Self:
        """The same motions with a ramp that is `factor` times longer; unchanged where there is none."""
        return self


def midrange(position: FloatArray) -> FloatArray:
    """Middle (m,) of the extremes of positions (m, N)."""
    return np.asarray(0.5 * (position.min(axis=1) + position.max(axis=1)))


def middle_of_range(low: float, high: float) -> float:
    """Middle of a joint's range; where it has no end, the place nearest to 0 with half a turn to both sides."""
    if np.isfinite(high - low):
        return 0.5 * (low + high)
    return float(np.clip(0.0, low + 0.5 * ONE_TURN, high - 0.5 * ONE_TURN))


def check_positive(name: str, value: float) -> None:
    """Refuse what is no time span; a UsageError."""
    if not 0.0 < value < np.inf:
        raise UsageError(f"a {name} of {value:g} s is not possible", hint="it must be a positive number of seconds")


def check_ramp(value: float) -> None:
    """Refuse a ramp that is shorter than a trajectory file may have; a UsageError."""
    if not SHORTEST_RAMP <= value < np.inf:
        raise UsageError(f"a ramp of {value:g} s is not possible", hint=f"it must be at least {SHORTEST_RAMP:g} s")


def check_count(name: str, value: int, least: int) -> None:
    """Refuse a number that is too small; a UsageError."""
    if value < least:
        raise UsageError(f"{value} {name}, but at least {least} must be given")


def unwrapped(motion: Motion) -> Motion:
    """The motion inside one that is played from rest to rest."""
    return motion.motion if isinstance(motion, RestToRest) else motion
