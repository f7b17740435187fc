"""When a CAN frame arrived: from the stamp that the kernel, or its sender, gave it where its clock is known."""

from __future__ import annotations

import math

import can

from drivers.core.clock import Clock

# Interfaces whose time stamps are the kernel's or the sender's clock of day, so that they give a frame's age.
_STAMPED_BY_CLOCK = frozenset({"SocketcanBus", "UdpMulticastBus", "VirtualBus"})
_CLOCK_CHECK = 0.1
_OLDEST = 1.0
_JITTER = 1e-3


class ArrivalClock:
    """Takes stamps of frames to the host's monotonic clock.

    Args:
        bus: whose frames they are.
        clock: the host's.
    """

    def __init__(self, bus: can.BusABC, clock: Clock) -> None:
        self._clock = clock
        self._stamped = type(bus).__name__ in _STAMPED_BY_CLOCK
        self._offset, self._checked = 0.0, -math.inf
        self._last = -math.inf

    def arrived(self, message: can.Message) -> float:
        """Arrival [s, the host's monotonic clock], from the frame's own stamp where it is the clock of day.

        It never runs back, also where the clock of day is set meanwhile.
        """
        now = self._clock.now()
        if not self._stamped:
            return now
        arrived = message.timestamp - self._offset
        if now - self._checked > _CLOCK_CHECK or not self._last <= arrived <= now:
            self._offset, self._checked = _clock_offset(self._clock), now
            arrived = message.timestamp - self._offset
        plausible = max(now - _OLDEST, self._last - _JITTER) < arrived <= now
        self._last = max(arrived, self._last) if plausible else now
        return self._last


def _clock_offset(clock: Clock) -> float:
    """Clock of day minus monotonic clock [s]; the least disturbed of three readings."""
    best = (math.inf, 0.0)
    for _ in range(3):
        before, day, after = clock.now(), clock.time_of_day(), clock.now()
        best = min(best, (after - before, day - 0.5 * (before + after)))
    return best[1]
