"""Tells whether an arm is at rest, judged from its positions."""

from __future__ import annotations

import math

import numpy as np

from drivers.core.arrays import FloatArray

REST_WINDOW = 0.1
"""How long [s] no joint may move for an arm to be at rest, unless the user asks for longer."""
REST_SPEED = 0.02
"""[rad/s]: what is slower than this over the window is rest."""

FLICKER = 0.0016
"""[rad]: a step of an encoder with 4096 a turn; one that shows two steps by turns is at rest."""


class StandstillWatch:
    """Follows the positions of an arm's joints; begins with an arm that may be moving, and again after each gap.

    At rest no joint moves within `window` [s]; in `longest_gap` [s] between positions the arm cannot have moved.
    """

    def __init__(self, longest_gap: float, window: float = REST_WINDOW) -> None:
        self._longest_gap = longest_gap
        self._window = window
        self._band = max(0.5 * REST_SPEED * window, FLICKER)
        self._reference: FloatArray | None = None
        self._since = self._newest = math.nan

    def add(self, time: float, position: FloatArray) -> None:
        """Take positions (n,) [rad or m] at a time [s]; times must not fall."""
        if not self._stays(time, position):
            self._reference, self._since = position.copy(), time
        self._newest = time

    def add_rows(self, time: FloatArray, position: FloatArray) -> None:
        """Take positions (N, n) [rad or m], N ≥ 1, at times (N,) [s], as `add` takes each of them."""
        if self._stays(float(time[-1]), position):
            self._newest = float(time[-1])
            return
        for moment, row in zip(time.tolist(), position, strict=True):
            self.add(moment, row)

    def _stays(self, time: float, position: FloatArray) -> bool:
        return (
            time - self._newest <= self._longest_gap
            and self._reference is not None
            and bool(np.abs(position - self._reference).max() < self._band)
        )

    @property
    def at_rest(self) -> bool:
        """Return whether no joint has moved for the window."""
        return self._newest - self._since >= self._window
