"""This computer's clock against those of the drives, which time their heartbeats: SYNC and its rows know one clock."""

from __future__ import annotations

from drivers.clock_rates import COMPARING_LIMIT, ClockRates
from drivers.core.clock import Clock

_POLL = 0.01


class HeartbeatClocks:
    """Compares the clocks of several drives with this computer's; one drive alone may have another heartbeat time.

    Args:
        count: of drives.
        period: of their heartbeats, as it was written to them [s].
    """

    def __init__(self, count: int, period: float) -> None:
        self._period = period
        self._beats = [0] * count
        self._rates = [ClockRates("the drives' clock", "their heartbeat time (0x1017)") for _ in range(count)]
        self._said = [""] * count

    @property
    def wrong(self) -> str:
        """What is wrong, in words, where all drives whose heartbeats come agree; else empty."""
        said = [self._said[index] for index, beats in enumerate(self._beats) if beats]
        return said[0] if said and all(said) else ""

    def take(self, index: int, arrived: float) -> None:
        """A drive's heartbeat, which arrived at a time [s, host's monotonic clock]."""
        self._beats[index] += 1
        self._said[index] = self._rates[index].add(self._period * self._beats[index], arrived)

    def wait(self, clock: Clock) -> str:
        """What is wrong, once the clocks could be compared, or `COMPARING_LIMIT` has passed."""
        end = clock.now() + COMPARING_LIMIT
        while not any(rate.compared for rate in self._rates) and clock.now() < end:
            clock.sleep(_POLL)
        return self.wrong
