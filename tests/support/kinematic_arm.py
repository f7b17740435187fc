"""A driver of an arm that follows every command at once, with faults to order; for the tests of daq."""

from __future__ import annotations

import threading
import time

import numpy as np

from daq.robot import parse_robot
from drivers.base import Notice
from drivers.errors import ConnectionLostError
from drivers.streams import Block, ChannelLayout, StreamLayout

RATE = 200.0
NAMES = ("shoulder", "elbow")
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
    """Implements drivers.base.Driver; `after` [s] from the start, `fault` begins."""

    def __init__(self, fault: str = "", after: float = 0.3) -> None:
        self.fault, self.after = fault, after
        self.position = np.array([0.1, -0.1])
        self.commands: list[np.ndarray] = []
        self.opened = False
        self.stopped_at: float | None = None
        self.commands_after_stop = 0
        self._count = 0
        self._begun = 0.0
        self._noticed = False
        self._lock = threading.Lock()

    def open(self):
        self.opened = True

    def streams(self):
        quantities = ("position", "velocity", "torque", "temperature")
        return (StreamLayout("joints", tuple(ChannelLayout(name, NAMES) for name in quantities), RATE),)

    def start(self):
        self._begun = time.monotonic()

    @property
    def faulty(self) -> bool:
        return time.monotonic() - self._begun > self.after

    def read(self, timeout):
        end = time.monotonic() + timeout
        while True:
            due = int((time.monotonic() - self._begun) * RATE)
            if self.fault == "stale data" and self.faulty:
                time.sleep(timeout)
                return ()
            if self.fault == "lost connection" and self.faulty:
                raise ConnectionLostError("the connection broke")
            if self.fault == "bug" and self.faulty:
                raise KeyError("a bug")
            if due > self._count or time.monotonic() >= end:
                break
            time.sleep(0.001)
        if due == self._count:
            return ()
        ticks = np.arange(self._count, due)
        self._count = due
        ones = np.ones((len(ticks), 2))
        values = {
            "position": self.position * ones,
            "velocity": 0.0 * ones,
            "torque": 5.0 * ones,
            "temperature": 30.0 * ones,
        }
        if self.faulty and self.fault in values:
            values[self.fault][-1, 1] = 1000.0
        host = self._begun + (ticks + 1) / RATE
        return (Block("joints", 100.0 + ticks / RATE, host, values),)

    def notices(self):
        if self.fault == "protective stop" and self.faulty and not self._noticed:
            self._noticed = True
            return (Notice(101.0, "error", "protective stop"),)
        return ()

    def command(self, position):
        with self._lock:
            if self.stopped_at is not None:
                self.commands_after_stop += 1
            if not (self.fault == "tracking error" and self.faulty):
                self.position = np.array(position)
            self.commands.append(np.array(position))

    def stop(self):
        with self._lock:
            self.stopped_at = time.monotonic()

    def close(self):
        self.stop()
