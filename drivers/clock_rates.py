"""Whether this computer's monotonic clock and the arm's own run at the same rate: a motion's limits are in seconds."""

from __future__ import annotations

from collections import deque

FASTER = 1.5
"""Ratio of the rates from which a motion ends; sound clocks are within 1e-4 of each other."""
WINDOW, WINDOWS = 0.05, 8
"""So many intervals [s] in a row must show it, each so long by both clocks, …"""
LARGEST_SHIFT = 0.25
"""… or so long [s] by one of them."""
COMPARING_LIMIT = 1.0
"""How long [s] two clocks may take to show whether they differ, before a motion goes on without."""
STEADY_RATIO = 1.3
"""Largest over smallest ratio in them: a wrong clock is wrong evenly, late samples and stalled simulators are not."""
SET_BACK = 5e-3
"""A clock that says so much less [s] than before was set back: how long an arm was without a command is unknown."""


class ClockRates:
    """Compares two clocks as samples come.

    Stamps that are the host's own never differ: where an arm has no clock there is nothing to compare.

    Args:
        own: what the other clock is called in a message.
        rate: the setting that may be wrong in place of a clock.

    Attributes:
        compared: whether enough has come to tell sound clocks from wrong ones.
    """

    def __init__(self, own: str = "the arm's clock", rate: str = "the connection's rate") -> None:
        self.compared = False
        self._own, self._rate = own, rate
        self._begun: tuple[float, float] | None = None
        self._latest = float("-inf")
        self._ratios: deque[float] = deque(maxlen=WINDOWS)

    def add(self, time: float, host_time: float) -> str:
        """Take a sample's time by its source's clock and by the host's [s]; what is wrong, in words, or nothing."""
        if self._begun is None:
            self._begun = time, host_time
            return ""
        own, host = time - self._begun[0], host_time - self._begun[1]
        shorter, longer = sorted((abs(own), abs(host)))
        if shorter < WINDOW and longer < LARGEST_SHIFT:
            return ""
        self._begun = time, host_time
        if own <= 0.0 or host <= 0.0:  # set back, or samples that came all at once
            self._ratios.clear()
            return ""
        self._ratios.append(own / host)
        self.compared = self.compared or len(self._ratios) == WINDOWS or 1.0 / FASTER <= own / host <= FASTER
        least, most = min(self._ratios), max(self._ratios)
        differ = least > FASTER or most < 1.0 / FASTER
        if len(self._ratios) < WINDOWS or not differ or most > STEADY_RATIO * least:
            return ""
        ratio = sum(self._ratios) / WINDOWS
        return (
            f"{self._own} runs at {ratio:.2f} times the rate of this computer's: one of them is wrong, or {self._rate}"
        )

    def looked(self, now: float) -> str:
        """Take the host's time [s], asked whenever samples come; what is wrong where it was set back, or nothing."""
        before, self._latest = self._latest, now
        return f"this computer's clock was set back by {before - now:.3f} s" if now < before - SET_BACK else ""
