"""Positions that an arm follows a fixed time after they were due, so that a late one changes nothing.

servoj slows an arm down at once where its target stands still: from v [rad/s] by up to 0.74·v divided by the lookahead,
within 0.05 s. A target that is played behind the positions that were sent goes on through a stall of their sender.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from drivers.core.arrays import FloatArray
from drivers.core.clock import STALL_LIMIT

KNOTS = 4
"""Positions that tell the path of the last 1.5 times `DELAY`, by a polynomial through them."""
DELAY = STALL_LIMIT + 0.01
"""How long [s] after a position was due the arm is to be there."""
PULL, CATCH_UP, MOST = 0.003, 0.012, 0.05
"""By which share the path is played slower for each half `DELAY` that it is ahead, and faster where it is behind; and
at most. It makes up for clocks that differ, and for what the player itself missed."""
_LONGEST_STEP = 2.0
"""Periods that are made up for at once; a player that was late for longer goes on where it was."""
_KEPT = 1.0
"""[s] of the path."""


def knot_distance(rate: float) -> int:
    """Return how many positions of a rate [Hz] knots are apart."""
    return max(1, round(0.5 * DELAY * rate))


class DelayedPath:
    """Positions of joints, one every period of a rate [Hz].

    Attributes:
        tick: number of the newest position, from 0 on.
    """

    def __init__(self, rate: float) -> None:
        self.tick = -1
        self._rate, self._distance = rate, knot_distance(rate)
        self._begin = self._behind = self._now = 0.0
        self._positions: deque[FloatArray] = deque(maxlen=max(KNOTS * self._distance, round(_KEPT * rate)))

    def put(self, due: float, position: FloatArray) -> None:
        """Take a position (n,) that is due at a time [s]; what is left out before it lies on a straight line."""
        if not self._positions:
            self._begin, self._now, self._behind = due, due, 2.0 * self._distance
            self._positions.append(position)
        tick = round((due - self._begin) * self._rate)
        missing, before = tick - self.tick, self._positions[-1]
        self._behind += max(missing, 0) if self.tick >= 0 else 0
        self._positions.extend(before + (position - before) * n / missing for n in range(1, missing + 1))
        self.tick = max(tick, self.tick)

    def knots(self) -> Sequence[FloatArray]:
        """Return the newest position and those one, two and three times the distance of knots before it."""
        last = len(self._positions) - 1
        return [self._positions[max(last - n * self._distance, 0)] for n in range(KNOTS)]

    def advance(self, now: float) -> FloatArray:
        """Return where the arm is to be now [s], having been where this said before."""
        passed = min((now - self._now) * self._rate, _LONGEST_STEP)
        late = (self._behind - passed) / self._distance - 2.0
        self._behind = max(self._behind - passed * (1.0 + min(late * (CATCH_UP if late > 0.0 else PULL), MOST)), 0.0)
        self._now = now
        whole, part = divmod(min(self._behind, len(self._positions) - 1.0), 1.0)
        newer = self._positions[-1 - int(whole)]
        return newer + part * (self._positions[max(-2 - int(whole), -len(self._positions))] - newer)
