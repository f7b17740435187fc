"""A design problem whose optimum is known: keep two joints near a point of least cost, within a limit each."""

from __future__ import annotations

import os
import signal
from dataclasses import replace
from functools import partial

import numpy as np

from daq.motion.trajectories import FourierSeries
from daq.robot.schema import JointLimits
from drivers.core.errors import UsageError
from ident.excite.constraints.soft_maximum import soft_maximum
from ident.excite.families.moving_joints import MovingJoints
from ident.excite.path import JointPath
from ident.excite.search.problem import DesignProblem

BEST = np.array([0.5, 2.0])
LIMIT = 1.0


class Still:
    """Two joints that rest at x."""

    size = 2
    joints = MovingJoints(
        tuple(JointLimits(name=name, position=(-10.0, 10.0), velocity=1.0, acceleration=1.0) for name in ("j1", "j2")),
        (0, 1),
        np.zeros(2),
    )

    def grid(self, count):
        return np.linspace(0.0, 1.0, count)

    def path(self, variables, time):
        zero = np.zeros((2, len(time)))
        return JointPath(time, zero + variables[:, None], zero, zero)

    def pull_back(self, variables, time, gradient):
        return gradient[..., 0, :, :].sum(axis=-1)

    def middle(self, variables):
        return variables

    def about(self, variables, pose, share):
        return np.array(pose)

    def motion(self, variables):
        return FourierSeries(1.0, variables, np.zeros((2, 1)), np.zeros((2, 1)))

    def begun_near_middle(self, variables):
        return variables

    def with_longer_ramp(self, factor):
        return self

    def random(self, generator):
        return generator.uniform(-1.0, 1.0, 2)


class Distance:
    """Squared distance from BEST, with shallow waves that make local optima."""

    def cost(self, path):
        return self.smooth_cost(path, np.inf)[0]

    def smooth_cost(self, path, sharpness):
        away = path.position[:, 0] - BEST
        gradient = np.zeros((3, *path.position.shape))
        gradient[0, :, 0] = 2.0 * away + 0.3 * np.sin(6.0 * away)
        return float(away @ away + 0.05 * np.sum(1.0 - np.cos(6.0 * away))), gradient


class Below:
    """Both joints stay below LIMIT."""

    names = ("position of j1", "position of j2")

    def use(self, path):
        return path.position.max(axis=1) / LIMIT

    def smooth_use(self, path, sharpness):
        bound, weights = soft_maximum(path.position / LIMIT, sharpness)
        gradient = np.zeros((2, 3, *path.position.shape))
        gradient[[0, 1], 0, [0, 1]] = weights / LIMIT
        return bound, gradient


def toy_problem(fault: str = "") -> DesignProblem:
    """The problem; building it may raise, or end the process."""
    if fault == "raise":
        raise UsageError("refused on purpose")
    if fault == "die":
        os._exit(3)
    if fault == "hang":
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        signal.pause()
    return DesignProblem(Still(), Distance(), Distance(), (Below(),), np.linspace(0.0, 1.0, 4), 0.99)


def maker(**choices):
    """Something picklable that builds the problem."""
    return partial(toy_problem, **choices)


class _Slow(Below):
    """Limits whose every evaluation takes a while."""

    def __init__(self, clock, seconds):
        self._clock = clock
        self._seconds = seconds

    def use(self, path):
        self._clock.stall(self._seconds)
        return super().use(path)


def slow_problem(clock, seconds) -> DesignProblem:
    """The problem, with limits whose exact evaluation takes so long [s] by a simulated clock."""
    return replace(toy_problem(), constraints=(_Slow(clock, seconds),))


class _Here(Below):
    """A limit that uses 3 at best, and that of the second joint."""

    names = ("distance from here", "position of j2")

    def use(self, path):
        return np.array([self.smooth_use(path, 1e6)[0][0], super().use(path)[1]])

    def smooth_use(self, path, sharpness):
        bound, gradient = super().smooth_use(path, sharpness)
        away = path.position[0] - 0.5
        bound[0], weights = soft_maximum(3.0 + away**2, sharpness)
        gradient[0] = 0.0
        gradient[0, 0, 0] = weights * 2.0 * away
        return bound, gradient


def impossible_problem() -> DesignProblem:
    """A problem of which one limit is exceeded in every pose."""
    return replace(toy_problem(), constraints=(_Here(),))


class _Above:
    """The first joint stays above 1.51, where `Below` leaves it no room."""

    names = ("height of j1",)

    def use(self, path):
        return np.array([2.5 - path.position[0].min()])

    def smooth_use(self, path, sharpness):
        bound, weights = soft_maximum(2.5 - path.position[:1], sharpness)
        gradient = np.zeros((1, 3, *path.position.shape))
        gradient[0, 0, 0] = -weights[0]
        return bound, gradient


def contradictory_problem() -> DesignProblem:
    """A problem whose two limits exclude each other."""
    return replace(toy_problem(), constraints=(Below(), _Above()))
