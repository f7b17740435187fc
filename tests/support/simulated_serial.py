"""A serial line in simulated time: a socket pair, one end of which pyserial's clients take for a serial port."""

from __future__ import annotations

import fcntl
import itertools
import socket
import struct
import termios
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import can.bus
import pytest
import serial
from simulated_clock import SimulatedClock

_numbers = itertools.count()


class SimulatedLine:
    """Both ends; the far one is a port as `sim_drivers.can.slcan_adapter.SlcanAdapter` wants it.

    Args:
        clock: of the test.

    Attributes:
        path: what a client opens.
        near: the client's end, for a test that speaks for itself.
    """

    def __init__(self, clock: SimulatedClock) -> None:
        self.path = f"simulated-line-{next(_numbers)}"
        self.near, self._far = socket.socketpair()
        for end in (self.near, self._far):
            end.setblocking(False)
            end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        self._clock = clock

    def fileno(self) -> int:
        """Return the file descriptor of the far end."""
        return self._far.fileno()

    def write(self, data: bytes) -> None:
        """Say something at the far end."""
        self._far.sendall(data)

    def plug_in(self) -> None:
        """It is from the start."""

    def pull_out(self) -> None:
        self._far.close()

    def remove(self) -> None:
        self._far.close()

    def read_until(self, end: bytes, seconds: float = 1.0) -> bytes:
        """What comes at the near end up to one of some bytes, or for so long [s]."""
        client, received = SerialPort(self, self._clock, seconds), b""
        while not received or received[-1] not in end:
            byte = client.read()
            if not byte:
                break
            received += byte
        return received


class SerialPort:
    """What python-can's slcan uses of `serial.Serial`."""

    def __init__(self, line: SimulatedLine, clock: SimulatedClock, timeout: float) -> None:
        self._line, self._clock, self._timeout = line, clock, timeout
        self.write_timeout: float | None = None

    @property
    def in_waiting(self) -> int:
        return int(struct.unpack("i", fcntl.ioctl(self._line.near, termios.FIONREAD, bytes(4)))[0])

    def read(self, size: int = 1) -> bytes:
        readable, _ = self._clock.select([self._line.near], [], self._timeout)
        if not readable:
            return b""
        data = self._line.near.recv(size)
        if not data:
            raise serial.SerialException("device reports readiness to read but returned no data")
        return data

    def write(self, data: bytes) -> int:
        try:
            self._line.near.sendall(data)
        except OSError as error:
            raise serial.SerialException(f"write failed: {error}") from error
        return len(data)

    def flush(self) -> None:
        """Nothing waits here."""

    def reset_input_buffer(self) -> None:
        while self.in_waiting:
            self._line.near.recv(4096)

    def close(self) -> None:
        """The line stays, for another client."""


@contextmanager
def simulated_line(clock: SimulatedClock) -> Iterator[SimulatedLine]:
    """A line that pyserial opens by its path; the time-outs of python-can are of this clock meanwhile."""
    line = SimulatedLine(clock)

    def open_port(url: str, *_: object, timeout: float, **__: object) -> Any:
        assert url == line.path
        return SerialPort(line, clock, timeout)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(serial, "serial_for_url", open_port)
        patch.setattr(serial.serialutil.Timeout, "TIME", staticmethod(clock.now))
        patch.setattr(can.bus, "time", clock.now)
        try:
            yield line
        finally:
            line.remove()
            line.near.close()
