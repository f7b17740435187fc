"""Stand-ins for ur_rtde's control interface that log their calls; `host` is the log file."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from pathlib import Path


class FakeControl:
    def __init__(self, host: str, rate: float) -> None:
        self._log = Path(host)
        self.write(f"control {os.getpid()} {rate:g}")

    def write(self, line: str) -> None:
        with self._log.open("a") as log:
            log.write(line + "\n")

    def servoJ(
        self, q: Sequence[float], speed: float, acceleration: float, time: float, lookahead: float, gain: float
    ) -> bool:
        self.write(f"servoJ {q[0]:g} {time:g}")
        return True

    def setWatchdog(self, min_frequency: float) -> bool:
        return True

    def kickWatchdog(self) -> bool:
        self.write("kickWatchdog")
        return True

    def servoStop(self, a: float) -> bool:
        self.write("servoStop")
        return True

    def isConnected(self) -> bool:
        return True

    def isProgramRunning(self) -> bool:
        return False

    def stopJ(self, a: float) -> None:
        self.write("stopJ")

    def stopScript(self) -> None:
        self.write("stopScript")

    def disconnect(self) -> None:
        self.write("disconnect")


class PrintingControl(FakeControl):
    """Writes to standard output as a C++ library does, past Python's own `sys.stdout`."""

    def servoJ(
        self, q: Sequence[float], speed: float, acceleration: float, time: float, lookahead: float, gain: float
    ) -> bool:
        os.write(1, b"Reconnecting...\n")
        return super().servoJ(q, speed, acceleration, time, lookahead, gain)


class UnwatchedControl(FakeControl):
    """Refuses the watchdog."""

    def setWatchdog(self, min_frequency: float) -> bool:
        return False


class CutOffControl(FakeControl):
    """Cannot reach the controller any more when the arm is to be stopped."""

    def servoStop(self, a: float) -> bool:
        return False

    def isConnected(self) -> bool:
        return False


class WatchedControl(FakeControl):
    """Logs the watchdog's setting."""

    def setWatchdog(self, min_frequency: float) -> bool:
        self.write(f"setWatchdog {min_frequency:g}")
        return True


class RefusingControl(FakeControl):
    """Refuses positions from 1 rad on, as after a protective stop; cannot leave servo mode either."""

    def servoJ(
        self, q: Sequence[float], speed: float, acceleration: float, time: float, lookahead: float, gain: float
    ) -> bool:
        return q[0] < 1.0

    def servoStop(self, a: float) -> bool:
        raise RuntimeError("not in servo mode")


class DyingControl(FakeControl):
    """Ends the whole process, as a crash in ur_rtde would."""

    def servoJ(
        self, q: Sequence[float], speed: float, acceleration: float, time: float, lookahead: float, gain: float
    ) -> bool:
        os._exit(3)


def hang(host: str, rate: float) -> FakeControl:
    Path(host).write_text(f"hang {os.getpid()}\n")
    _sleep_for_ever()
    raise AssertionError


def _sleep_for_ever() -> None:
    while True:
        time.sleep(1.0)


def move_and_print(log: str) -> None:
    """A motion of a control interface that prints."""
    import numpy as np

    from drivers.rtde.motion import MotionProcess

    motion = MotionProcess(log, 500.0, 60.0, PrintingControl)
    motion.command(np.zeros(6), time.monotonic())
    while "servoJ" not in Path(log).read_text():
        time.sleep(0.01)
    motion.stop()
    print("only this", flush=True)


def move_for_ever(log: str) -> None:
    """Take control and move; print so, and wait (for a process that a test kills)."""
    import numpy as np

    from drivers.rtde.motion import MotionProcess

    motion = MotionProcess(log, 500.0, 60.0, FakeControl)
    motion.command(np.zeros(6), time.monotonic())
    print("moving", flush=True)
    while True:
        motion.command(np.full(6, 0.5), time.monotonic())
        time.sleep(0.002)
