"""Serial lines within a test: what one end writes is read at the other, a port of pyserial, in simulated time.

A pseudo-terminal hands its characters over when the kernel finds time to.
"""

from __future__ import annotations

import errno
import os

import serial
from simulated_clock import SimulatedClock

LINES: dict[str, SerialLine] = {}
"""By their URL."""

serial.protocol_handler_packages.append(__name__)


class SerialLine:
    """A line whose device's end is held here; it stands for a `PseudoTerminal` that sends.

    Args:
        clock: of the test.
        name: of the port.

    Attributes:
        path: URL of the port that reads it.
        said: when something was written [s], and what somebody took of it.
    """

    def __init__(self, clock: SimulatedClock, name: str = "port") -> None:
        self.clock = clock
        self.path = f"line://{name}"
        self.said: list[tuple[float, bytes]] = []
        self.opened = False
        self._plugs = 0
        self.plugged = False
        self._arrived = bytearray()
        LINES[self.path] = self

    def plug_in(self) -> None:
        if not self.plugged:
            self.plugged = True
            self._plugs += 1

    def pull_out(self) -> None:
        self.plugged = self.opened = False
        self._arrived.clear()

    def write(self, data: bytes) -> int:
        if not self.opened:
            return 0
        self.said.append((self.clock.now(), bytes(data)))
        self._arrived += data
        return len(data)

    def say(self, text: str) -> None:
        """Send text, which somebody must take."""
        assert self.write(text.encode()) == len(text)

    def remove(self) -> None:
        LINES.pop(self.path, None)

    # The reader's end.

    def open(self) -> int:
        """Open the port; which plugging-in of it that is."""
        if not self.plugged:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), self.path)
        if self.opened:
            raise serial.SerialException("Could not exclusively lock port")
        self._arrived.clear()
        self.opened = True
        return self._plugs

    def close(self, plug: int) -> None:
        """Close the port, unless it was pulled out meanwhile."""
        if plug == self._plugs:
            self.opened = False

    def read(self, plug: int, size: int, seconds: float) -> bytes:
        """What has come within a while [s], or as soon as `size` bytes have."""
        self.clock.wait(lambda: self._gone(plug) or len(self._arrived) >= size, seconds)
        if self._gone(plug):
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        data = bytes(self._arrived[:size])
        del self._arrived[:size]
        return data

    def _gone(self, plug: int) -> bool:
        return not self.plugged or plug != self._plugs
