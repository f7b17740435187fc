"""A motion on a grid of times, and the interfaces of motion families and constraints."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from daq.motion.fourier_quintic import FourierQuintic
from daq.motion.trajectories import Motion, RestToRest
from daq.motion.trajectory_file import Trajectory
from daq.robot.schema import JointLimits
from drivers.core.arrays import FloatArray


@dataclass(frozen=True)
class JointPath:
    """A joint motion on a grid of times.

    Attributes:
        time: (N,) [s].
        position: (n, N) [rad or m].
        velocity: (n, N) [rad/s or m/s].
        acceleration: (n, N) [rad/s² or m/s²].
    """

    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray


def repeated_for(motion: Motion, seconds: float) -> Motion:
    """The motion with so many of its repetitions as last `seconds`; one at least, which takes all of its values."""
    if not isinstance(motion, RestToRest | FourierQuintic):
        return motion
    once = replace(motion, periods=1)
    more = max(0.0, seconds - once.duration) * (motion.periods - 1) / max(motion.duration - once.duration, 1e-9)
    return replace(motion, periods=min(motion.periods, 1 + int(more)))


class Family(Protocol):
    """Motions of one form, given by a vector x of `size` decision variables.

    The variables are scaled to the order of 1 at high limit utilisation.
    """

    @property
    def size(self) -> int:
        """Number of decision variables."""

    @property
    def limits(self) -> tuple[JointLimits, ...]:
        """Limits (n,) of all joints."""

    @property
    def moving(self) -> tuple[int, ...]:
        """Indices (m,) of the joints that move, ascending."""

    @property
    def rest(self) -> FloatArray:
        """(n,) rest positions of the other joints [rad or m]."""

    def grid(self, count: int) -> FloatArray:
        """About `count` times (N,) [s] that cover everything that is played, for designing (not for the last check)."""

    def path(self, variables: FloatArray, time: FloatArray) -> JointPath:
        """The motion of x at times (N,) [s]."""

    def pull_back(self, variables: FloatArray, time: FloatArray, gradient: FloatArray) -> FloatArray:
        """∂/∂x of scalars whose derivatives by position, velocity and acceleration are given.

        Args:
            variables: x (size,).
            time: (N,) [s].
            gradient: (..., 3, n, N), by position, velocity, acceleration of every joint and time.

        Returns:
            (..., size).
        """

    def random(self, generator: np.random.Generator) -> FloatArray:
        """A random x that keeps the position, velocity and acceleration limits on the grid."""

    def middle(self, variables: FloatArray) -> FloatArray:
        """Middle (m,) of the range of each moving joint's motion [rad or m]."""

    def about(self, variables: FloatArray, pose: FloatArray, share: float) -> FloatArray:
        """The x of the same motion with another middle, its amplitude multiplied by a factor.

        Args:
            variables: x (size,).
            pose: (m,) the new middle [rad or m].
            share: the factor, 0 for an arm that rests in the pose.
        """

    def motion(self, variables: FloatArray) -> Motion:
        """The motion as played, from rest to rest."""

    def trajectory(self, variables: FloatArray, robot: str, comment: str) -> Trajectory:
        """The same as the content of a trajectory file for the robot of that name."""

    def encode(self, motion: Motion) -> FloatArray:
        """The x of a motion that was designed or written earlier.

        Raises:
            UsageError: it is not of this form; names the difference.
        """

    def begun_near_middle(self, variables: FloatArray) -> FloatArray:
        """The x of the same closed path, begun where it comes nearest to the middle of all joints' ranges.

        An arm is slow on its approach. Unchanged where the path has a fixed beginning.
        """

    def with_longer_ramp(self, factor: float) -> Family:
        """The same motions with a ramp that is `factor` times longer; unchanged where there is none."""


class Constraint(Protocol):
    """A limit on the motion; each value is a limit utilisation, 1 at the limit."""

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each value, for messages (`velocity of elbow`)."""

    def use(self, path: JointPath) -> FloatArray:
        """(m,) largest utilisation along the path, exactly on its grid; ≤ 1 is allowed."""

    def smooth_use(self, path: JointPath, sharpness: float) -> tuple[FloatArray, FloatArray]:
        """A smooth upper bound (m,) of `use` and its derivatives (m, 3, n, N).

        The bound is the soft maximum over the grid and tightens as `sharpness` grows.
        """
