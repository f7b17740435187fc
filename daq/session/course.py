"""The state of a running session, and what shows it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from daq.recording.quality.clocks import ClockLog
from daq.recording.recording import JOINTS_STREAM
from daq.session.command_gate import CommandGate
from daq.session.supervisor import Breach
from daq.session.watch import Watch
from drivers.clock_rates import ClockRates
from drivers.core.arrays import FloatArray
from drivers.core.clock import Clock
from drivers.standstill import StandstillWatch
from drivers.streams import Batch

REST_TIME = 0.5
"""How long [s] an arm, and what its controller aims at, must have been at rest before control of it is taken."""
RECENT = 1.0
"""How long [s] after a stall of this computer, or the end of a hold by one, what happens may be its consequence."""
END_OTHERS = "end other programs, or use --realtime"
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
    what the controller aims at; `untrusted` is why the clocks cannot be trusted, in words; `resumed` is when the arm
    went on after a stall [s, host's clock]; `touched` is whether a contact ended the
    motion, `retracting` whether the arm goes back from it.
    """

    clock: Clock
    clocks: ClockLog
    samples: dict[str, int] = field(default_factory=dict)
    lost: dict[str, int] = field(default_factory=dict)
    position: FloatArray | None = None
    torque: FloatArray | None = None
    heard: float = float("-inf")
    rest: StandstillWatch = field(default_factory=lambda: StandstillWatch(GAP, REST_TIME))
    gate: CommandGate | None = None
    source_minus_host: float = float("nan")
    view: View | None = None
    watch: Watch | None = None
    moves: bool = False
    touched: bool = False
    retracting: bool = False
    interrupted: str | None = None
    breach_time: float = float("nan")
    silent: set[str] = field(default_factory=set)
    stuck: set[tuple[str, str]] = field(default_factory=set)
    host_ahead: dict[str, float] = field(default_factory=dict)
    rates: ClockRates = field(default_factory=ClockRates)
    untrusted: str = ""
    resumed: float = float("-inf")

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
            if (torque := batch.values.get("torque")) is not None and torque.shape[1] == len(self.position):
                self.torque = torque[-1].copy()
            self.heard = float(batch.host_time[-1])
            differ = self.rates.looked(self.clock.now()) or self.rates.add(float(batch.time[-1]), self.heard)
            self.untrusted = differ or self.untrusted
            watched = [batch.values[name] for name in ("position", "target_position") if name in batch.values]
            self.rest.add_rows(batch.host_time, np.hstack(watched))
            if self.gate is not None:
                self.gate.measured(self.clock.now(), self.position)
            self.source_minus_host = float(batch.time[-1] - batch.host_time[-1])
        if self.watch is not None:
            self.watch.add(batch)
        if self.view is not None:
            self.view.add(batch)

    def source_time(self) -> float:
        """Now, in the clock of the joints' stream [s]."""
        return self.clock.now() + self.source_minus_host

    def cure(self, breach: Breach) -> str:
        """Return what to do about a limit that was passed; soon after the arm went on from a stall, about the stall."""
        now = self.clock.now()
        if breach.what == "stale data" and self.clock.stalled(now - RECENT) > 0.5 * breach.value:
            return END_OTHERS
        if now - self.resumed > RECENT:
            return breach.cure
        return f"{now - self.resumed:.2g} s before, the arm was resumed after a stall of this computer: {END_OTHERS}"

    def joints_time(self, when: float, stream: str) -> float:
        """A time of a stream's clock, in the clock of the joints' stream [s]."""
        if stream == JOINTS_STREAM or JOINTS_STREAM not in self.host_ahead:
            return when
        return when + self.host_ahead[stream] + self.source_minus_host
