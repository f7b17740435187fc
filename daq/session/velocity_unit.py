"""Velocities that contradict the positions beside them: another unit, scale or sign, by which no limit would hold."""

from __future__ import annotations

import numpy as np

from drivers.core.arrays import FloatArray, IndexArray

SLOWEST = 0.1
"""[rad/s or m/s]: slower joints are not judged."""
LEAST, MOST = 0.5, 2.0
"""The velocity over the change of position, from which or up to which it is the same quantity, but for its filter."""
WINDOWS = 6
"""So many segments in a row must show it, all on the same side; a velocity that repeats in all of them is stale."""


class VelocityUnit:
    """Compares the velocities of one stream with the speeds of its positions.

    Args:
        joints: how many.
    """

    def __init__(self, joints: int) -> None:
        self._sum, self._count = np.zeros(joints), 0
        self._below, self._above = np.zeros((2, joints), dtype=int)
        self._last, self._varied = np.full(joints, np.nan), np.zeros(joints, dtype=bool)
        self.mean, self.speed = np.zeros(joints), np.zeros(joints)
        """Of the segment that was compared last [rad/s or m/s]."""

    def add(self, velocity: FloatArray, speed: FloatArray) -> IndexArray:
        """Take samples; returns the joints whose velocity is another quantity.

        Args:
            velocity: (N, n) [rad/s or m/s].
            speed: (n,) of the positions since the last one that was no NaN [rad/s or m/s]; else NaN.
        """
        self._sum += velocity.sum(axis=0)
        self._count += len(velocity)
        self._varied |= (velocity != self._last).any(axis=0)
        self._last = velocity[-1].copy()
        if np.isnan(speed).all():
            return np.array([], dtype=np.intp)
        self.mean, self.speed = self._sum / self._count, speed
        self._sum, self._count = np.zeros(len(speed)), 0
        with np.errstate(invalid="ignore", divide="ignore"):
            ratio, fast = self.mean / speed, np.abs(speed) >= SLOWEST
        self._below = np.where(fast, np.where(ratio < LEAST, self._below + 1, 0), self._below)
        self._above = np.where(fast, np.where(ratio > MOST, self._above + 1, 0), self._above)
        lasting = np.maximum(self._below, self._above)
        self._varied &= lasting > 0
        return np.flatnonzero((lasting >= WINDOWS) & self._varied)
