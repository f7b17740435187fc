"""A driver of an arm that is where it was told to be, and whose samples come exactly when they are due."""

from __future__ import annotations

import numpy as np
from kinematic_arm import NAMES, RATE

from drivers.clock import Clock
from drivers.streams import Batch, ChannelLayout, StreamLayout

FIRST_STAMP = 100.0
"""Of the arm's own clock at its first sample [s]."""


class PunctualArm:
    """Implements drivers.base.Driver.

    Attributes:
        commands: when each came [s], and the position (n,).
        samples: positions (n,) handed out.
        begun, stopped: when [s]; nan before.
    """

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.position = np.array([0.1, -0.1])
        self.commands: list[tuple[float, np.ndarray]] = []
        self.samples: list[np.ndarray] = []
        self.begun = self.stopped = float("nan")
        self.calls: list[str] = []

    def open(self):
        self.calls.append("open")

    def streams(self):
        quantities = ("position", "velocity", "torque", "temperature")
        return (StreamLayout("joints", tuple(ChannelLayout(name, NAMES) for name in quantities), RATE),)

    def start(self):
        self.calls.append("start")
        self.begun = self.clock.now()

    def read(self, timeout):
        count = len(self.samples)
        self.clock.sleep(min(self.begun + (count + 1) / RATE - self.clock.now(), timeout))
        due = int((self.clock.now() - self.begun) * RATE + 1e-6)
        if due == count:
            return ()
        numbers = np.arange(count, due)
        position = np.tile(self.position, (len(numbers), 1))
        self.samples.extend(position)
        rest = np.zeros_like(position)
        values = {"position": position, "velocity": rest, "torque": rest + 5.0, "temperature": rest + 30.0}
        return (Batch("joints", FIRST_STAMP + numbers / RATE, self.begun + (numbers + 1) / RATE, values),)

    def notices(self):
        return ()

    def command(self, position):
        self.position = position.copy()
        self.commands.append((self.clock.now(), position))

    def stop(self):
        self.calls.append("stop")
        self.stopped = self.clock.now()

    def close(self):
        self.calls.append("close")

    def stamp(self, host_time: float) -> float:
        """A time of the host's clock [s] in the arm's own."""
        return FIRST_STAMP + host_time - self.begun - 1.0 / RATE
