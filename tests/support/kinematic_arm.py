"""A driver of an arm that follows every command at once, with faults to order; for the tests of daq."""

from __future__ import annotations

import math
import threading

import numpy as np

from daq.robot.loader import parse_robot
from drivers.base import Notice
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.errors import ConnectionLostError
from drivers.streams import Batch, ChannelLayout, StreamLayout

RATE = 200.0
NAMES = ("shoulder", "elbow")
QUANTITIES = ("position", "velocity", "torque", "temperature")
FIRST_STAMP = 100.0
"""Reading of the arm's own clock at `start` [s]."""
ROBOT_FILE = parse_robot(
    """
name: two-links
model:
  mdh:
    - {joint: shoulder, alpha: 0, d: 0, r: 0.3, antecedent: base}
    - {joint: elbow, alpha: pi/2, d: 0.4, r: 0, antecedent: shoulder}
joints:
  - {name: shoulder, position: [-3, 3], velocity: 2, torque: 50, temperature: 70}
  - {name: elbow, position: [-2, 2], velocity: 2, torque: 50, temperature: 70}
connections:
  bench: {driver: kinematic, rate: 200}
""",
    where="test",
    folder=None,
)


class KinematicArm:
    """Implements drivers.base.Driver: sample k is taken k + 1 periods after `start` and read at that moment.

    Args:
        fault: what goes wrong; a quantity's name makes its newest value of the second joint 1000.
        after: how long after `start` it begins [s].
        rate: of the samples [Hz].
        clock: the host's.
    """

    def __init__(self, fault: str = "", after: float = 0.3, rate: float = RATE, clock: Clock = SYSTEM_CLOCK) -> None:
        self.fault, self.after, self.rate, self.clock = fault, after, rate, clock
        self.position = np.array([0.1, -0.1])
        self.samples: list[Batch] = []
        """All that was handed out."""
        self.commands: list[np.ndarray] = []
        self.command_times: list[float] = []
        self.opened = False
        self.calls: list[str] = []
        """open, start, take_control, stop and close, in their order."""
        self.begun = math.nan
        self.stopped_at: float | None = None
        self.commands_after_stop = 0
        self.count = 0
        """Samples that were handed out."""
        self._noticed = False
        self._lock = threading.Lock()

    @property
    def positions(self):
        """All positions handed out (N, 2)."""
        return np.concatenate([batch.values["position"] for batch in self.samples])

    def stamp(self, host_time: float) -> float:
        """A time of the host's clock [s] in the arm's own."""
        return FIRST_STAMP + host_time - self.begun - 1.0 / self.rate

    def open(self):
        self.opened = True
        self.calls.append("open")

    def streams(self):
        return (StreamLayout("joints", tuple(ChannelLayout(name, NAMES) for name in QUANTITIES), self.rate),)

    def start(self):
        self.calls.append("start")
        self.begun = self.clock.now()

    @property
    def faulty(self) -> bool:
        return self.clock.now() - self.begun > self.after

    def read(self, timeout):
        end = self.clock.now() + timeout
        if self.fault != "stale data" or not self.faulty:
            end = min(end, self.begun + (self.count + 1) / self.rate)
        self.clock.sleep_until(end)
        if self.faulty and self.fault == "stale data":
            return ()
        if self.faulty and self.fault == "lost connection":
            raise ConnectionLostError("the connection broke")
        if self.faulty and self.fault == "bug":
            raise KeyError("a bug")
        due = int((self.clock.now() - self.begun) * self.rate + 1e-6)
        if due <= self.count:
            return ()
        ticks = np.arange(self.count, due)
        self.count = due
        ones = np.ones((len(ticks), 2))
        values = {
            "position": self.position * ones,
            "velocity": 0.0 * ones,
            "torque": 5.0 * ones,
            "temperature": 30.0 * ones,
        }
        if self.faulty and self.fault in values:
            values[self.fault][-1, 1] = 1000.0
        host = self.begun + (ticks + 1) / self.rate
        self.samples.append(Batch("joints", FIRST_STAMP + ticks / self.rate, host, values))
        return (self.samples[-1],)

    def notices(self):
        if self.fault == "protective stop" and self.faulty and not self._noticed:
            self._noticed = True
            return (Notice(101.0, "error", "protective stop"),)
        return ()

    def command_rate(self):
        return self.rate

    def take_control(self):
        self.calls.append("take_control")

    def command(self, position):
        with self._lock:
            if self.stopped_at is not None:
                self.commands_after_stop += 1
            if not (self.fault == "tracking error" and self.faulty):
                self.position = np.array(position)
            else:  # its encoder flickers, so it is not the one that hangs
                self.position = self.position + 1e-9 * (-1) ** len(self.commands)
            self.commands.append(np.array(position))
            self.command_times.append(self.clock.now())

    def stop(self):
        self.calls.append("stop")
        with self._lock:
            self.stopped_at = self.clock.now()

    def close(self):
        self.calls.append("close")
        if self.stopped_at is None:
            self.stopped_at = self.clock.now()
