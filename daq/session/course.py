"""The state of a running session, and what shows it."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from daq.recording.clocks import ClockLog
from daq.recording.recording import JOINTS_STREAM
from daq.session.command_gate import CommandGate
from drivers.core.arrays import FloatArray
from drivers.core.clock import Clock
from drivers.standstill import StandstillWatch
from drivers.streams import Batch

FASTER = 1.5
"""Ratio of the rates from which a motion ends; sound clocks are within 1e-4 of each other."""
WINDOW, WINDOWS = 0.05, 8
"""So many intervals [s] in a row must show it, each so long by both clocks, …"""
LONGEST = 0.25
"""… or so long [s] by one of them."""
STEADY = 1.3
"""Largest over smallest ratio in them: a wrong clock is wrong evenly, late samples and stalled simulators are not."""


class ClockRates:
    """Compares two clocks as samples come.

    Stamps that are the host's own never differ: where an arm has no clock there is nothing to compare.
    """

    def __init__(self) -> None:
        self._begun: tuple[float, float] | None = None
        self._ratios: deque[float] = deque(maxlen=WINDOWS)

    def add(self, time: float, host_time: float) -> str:
        """Take a sample's time by its source's clock and by the host's [s]; what is wrong, in words, or nothing."""
        if self._begun is None:
            self._begun = time, host_time
            return ""
        own, host = time - self._begun[0], host_time - self._begun[1]
        shorter, longer = sorted((abs(own), abs(host)))
        if shorter < WINDOW and longer < LONGEST:
            return ""
        self._begun = time, host_time
        if own <= 0.0 or host <= 0.0:  # set back, or samples that came all at once
            self._ratios.clear()
            return ""
        self._ratios.append(own / host)
        least, most = min(self._ratios), max(self._ratios)
        differ = least > FASTER or most < 1.0 / FASTER
        if len(self._ratios) < WINDOWS or not differ or most > STEADY * least:
            return ""
        ratio = sum(self._ratios) / WINDOWS
        return (
            f"the arm's clock runs at {ratio:.2f} times the rate of this computer's: one of them is wrong, or the "
            "connection's rate"
        )


REST_TIME = 0.5
"""How long [s] an arm, and what its controller aims at, must have been at rest before control of it is taken."""
GAP = 0.1
"""Samples [s] apart in which an arm may have moved and come back."""


class View(Protocol):
    """Display of a running session; it must neither block nor raise."""

    def add(self, batch: Batch) -> None:
        """Note a batch."""

    def show(self, state: str, elapsed: float, total: float) -> None:
        """Show the state; `elapsed` of `total` [s]."""


@dataclass
class Course:
    """State of a running session.

    `breach_time` [s, the source's clock] is that of what stopped it, where it has one; `silent` are the streams whose
    silence is an event already, `stuck` the channels that hang and are one; `host_ahead` is by stream the host's clock
    less the source's at its last sample [s]; `heard` is the host's time of the newest position, `rest` watches it and
    what the controller aims at; `untrusted` is why the clocks cannot be trusted, in words.
    """

    clock: Clock
    clocks: ClockLog
    samples: dict[str, int] = field(default_factory=dict)
    lost: dict[str, int] = field(default_factory=dict)
    position: FloatArray | None = None
    heard: float = float("-inf")
    rest: StandstillWatch = field(default_factory=lambda: StandstillWatch(GAP, REST_TIME))
    gate: CommandGate | None = None
    source_minus_host: float = float("nan")
    view: View | None = None
    moves: bool = False
    interrupted: str | None = None
    breach_time: float = float("nan")
    silent: set[str] = field(default_factory=set)
    stuck: set[tuple[str, str]] = field(default_factory=set)
    host_ahead: dict[str, float] = field(default_factory=dict)
    rates: ClockRates = field(default_factory=ClockRates)
    untrusted: str = ""

    def add(self, batch: Batch) -> None:
        """Note a batch."""
        self.samples[batch.stream] = self.samples.get(batch.stream, 0) + len(batch.time)
        self.lost[batch.stream] = self.lost.get(batch.stream, 0) + batch.lost
        self.silent.discard(f"stream {batch.stream}")
        self.clocks.add(batch)
        if len(batch.time):
            self.host_ahead[batch.stream] = float(batch.host_time[-1] - batch.time[-1])
        if batch.stream == JOINTS_STREAM and len(batch.time):
            self.position = batch.values["position"][-1].copy()
            self.heard = float(batch.host_time[-1])
            self.untrusted = self.rates.add(float(batch.time[-1]), self.heard) or self.untrusted
            watched = [batch.values[name] for name in ("position", "target_position") if name in batch.values]
            for host_time, row in zip(batch.host_time.tolist(), np.hstack(watched), strict=True):
                self.rest.add(host_time, row)
            if self.gate is not None:
                self.gate.measured(self.clock.now(), self.position)
            self.source_minus_host = float(batch.time[-1] - batch.host_time[-1])
        if self.view is not None:
            self.view.add(batch)

    def source_time(self) -> float:
        """Now, in the clock of the joints' stream [s]."""
        return self.clock.now() + self.source_minus_host

    def joints_time(self, when: float, stream: str) -> float:
        """A time of a stream's clock, in the clock of the joints' stream [s]."""
        if stream == JOINTS_STREAM or JOINTS_STREAM not in self.host_ahead:
            return when
        return when + self.host_ahead[stream] + self.source_minus_host
