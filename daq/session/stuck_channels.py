"""Channels that repeat bit for bit for longer than their resolution and sampling explain: a sensor that hangs.

Each channel is its own measure. How long its values have stood before tells what is usual; how long they stand is
counted in what should have changed them: the commands for a position, the joint's own way for torque, current and
velocity (which it must have gone at different speeds), time for a temperature. Not judged are channels that have not
changed often enough; a temperature that changes between few values, or more and more slowly (it settles); a torque,
current or velocity whose changes are few steps of its resolution, so that it may as well have none.
"""

from __future__ import annotations

import numpy as np

from drivers.core.arrays import FloatArray, IndexArray

WATCHED = {"position": 0.05, "velocity": 0.1, "torque": 0.1, "current": 0.1, "temperature": 5.0}
"""Quantity → the least that is taken for a channel that hangs [rad or m; s of a temperature]."""
FACTOR = {"position": 5.0, "velocity": 10.0, "torque": 10.0, "current": 10.0, "temperature": 10.0}
"""A channel hangs from so many times the longest of its last stands."""
STANDS = 20
"""How many of these are kept; with fewer a channel is not judged."""
VALUES = 5
"""Different values among them, at least: noise below the resolution shows two, and stands between them."""
STEPS = {"position": 100.0, "velocity": 4.0, "torque": 4.0, "current": 4.0, "temperature": 0.0}
"""In steps of the resolution, the smallest change that was seen: how far the commands may move on without a position
(a small servo in real recordings stuck for 83); what the median of the last changes must be, of the three after it."""
SLOWER = 3.0
"""The longest of the later half of the stands over that of the earlier half, at most; of a temperature."""
SPEED_TIME, SPEED_CHANGE = 0.05, 0.1
"""Speed is that over so long [s]; at a constant one, to within this [rad/s or m/s], a torque may be constant."""
LOOK_EVERY, UNMOVED_EVERY, MOST_TOGETHER = 0.0099, 0.0399, 10
"""Samples are looked at so long [s] at a time, `UNMOVED_EVERY` where dynid does not move the arm; batches, at most."""


class StuckChannel:
    """One quantity of a stream, of `WATCHED`; a column may stand for `patience` [s] beyond what is explained."""

    def __init__(self, quantity: str, columns: int, patience: float) -> None:
        self._quantity, self._least, self._patience = quantity, WATCHED[quantity], patience
        self._last = np.full(columns, np.nan)
        self._low, self._high = np.full((2, columns), np.nan)
        self._slow, self._fast = np.full((2, columns), np.nan)
        self._speeds = np.zeros(columns, dtype=int)
        self._stands, self._values = np.zeros((2, STANDS, columns))
        self._step = np.full(columns, np.inf)
        self._changes = np.full(columns, -1)  # the first one ends no stand
        self._since = np.full(columns, np.nan)
        self._hangs = np.zeros(columns, dtype=bool)

    def add(self, time: float, values: FloatArray, way: FloatArray, speed: FloatArray) -> IndexArray:
        """Take consecutive samples (N, m), the last one at a time [s]; returns the columns that hang.

        `way` (m,) is what should change them, at the last sample [rad, m or s]; `speed` (m,) that of the joints [rad/s
        or m/s] where it is a new one, else NaN.
        """
        before = np.concatenate([self._last[np.newaxis], values[:-1]]) if len(values) > 1 else self._last
        changes = np.abs(values - before)
        changed = (changes != 0.0).any(axis=0)
        self._last = values[-1].copy()
        self._low, self._high = np.fmin(self._low, way), np.fmax(self._high, way)
        measured = ~np.isnan(speed)
        if measured.any():
            self._speeds += measured
            own = np.where(self._speeds > 1, speed, np.nan)  # the first one is that of a time before, too
            self._slow, self._fast = np.fmin(self._slow, own), np.fmax(self._fast, own)
        stood = self._high - self._low
        if changed.any():
            ended = changed.nonzero()[0]
            self._step = np.fmin(self._step, np.where(changes > 0.0, changes, np.inf).min(axis=0))
            slots = self._changes[ended] % STANDS
            self._stands[slots, ended], self._values[slots, ended] = stood[ended], values[-1, ended]
            self._changes[ended] += 1
            self._low[ended] = self._high[ended] = way[ended]
            self._slow[ended] = self._fast[ended] = np.nan
            self._speeds[ended] = 0
            self._since[ended], self._hangs[ended] = np.nan, False
        hangs = ~changed & ~self._hangs & (self._changes >= STANDS)
        if hangs.any():
            hangs &= stood > self._limits()
            if self._quantity not in ("position", "temperature"):
                hangs &= self._fast - self._slow > SPEED_CHANGE
        if hangs.any():
            self._since[hangs & np.isnan(self._since)] = time
            for column in np.flatnonzero(hangs & (time - self._since >= self._patience)).tolist():
                self._hangs[column] = self._tells(column)
        return self._hangs.nonzero()[0]

    def stood(self, column: int) -> tuple[float, float]:
        """Return how long a column has stood, and what is explained, both in what its stands are counted in."""
        return float((self._high - self._low)[column]), float(self._limits()[column])

    def _limits(self) -> FloatArray:
        limits = np.maximum(self._least, FACTOR[self._quantity] * self._stands.max(axis=0))
        return np.asarray(
            np.maximum(limits, STEPS["position"] * self._step) if self._quantity == "position" else limits
        )

    def _tells(self, column: int) -> bool:
        """Return whether the last stands of a column tell of the next one."""
        since = -(self._changes[column] % STANDS)
        stands, values = np.roll(self._stands[:, column], since), np.roll(self._values[:, column], since)
        if self._quantity == "temperature":
            earlier, later = np.split(stands, 2)
            return len(np.unique(values)) >= VALUES and bool(later.max() <= SLOWER * earlier.max())
        steps = np.median(np.abs(np.diff(values))) / self._step[column]
        return self._quantity == "position" or bool(steps >= STEPS[self._quantity])


class JointSpeed:
    """The joints' positions and, once per `SPEED_TIME`, their speeds over it; (n,), else NaN."""

    def __init__(self, joints: int) -> None:
        self.position, self.speed = np.full((2, joints), np.nan)
        self._from: tuple[float, FloatArray] | None = None

    def add(self, time: float, position: FloatArray) -> None:
        """Take the position (n,) [rad or m] at a time [s]."""
        self.position, self.speed = position, np.full(len(position), np.nan)
        if self._from is None or not 0.0 <= time - self._from[0] <= 10.0 * SPEED_TIME:
            self._from = time, position
        elif time - self._from[0] >= SPEED_TIME:
            self.speed = (position - self._from[1]) / (time - self._from[0])
            self._from = time, position
