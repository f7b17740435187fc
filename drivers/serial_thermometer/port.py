"""The port of a serial thermometer: a thread reads whole chunks, and opens the port again when it has gone."""

from __future__ import annotations

import contextlib
import math
import threading
from collections import deque
from dataclasses import dataclass

import serial

from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.serial_port import open_port, reason

READ_TIMEOUT = 0.01
"""Longest time [s] that a chunk is collected."""
CHUNK_BYTES = 4096
BUFFER_BYTES = 1 << 20
"""What may wait for `take` before the oldest is dropped."""
RETRY_PERIOD = 1.0
"""[s] between two attempts to open a port that has gone."""
CLOSE_LIMIT = 2.0


@dataclass(frozen=True)
class Chunk:
    """Bytes that arrived after `since` and until `until` [s, host's monotonic clock]."""

    data: bytes
    since: float
    until: float


@dataclass(frozen=True)
class Lost:
    """The port has gone, at `time` [s, host's monotonic clock]; `reason` in words."""

    time: float
    reason: str


@dataclass(frozen=True)
class Restored:
    """The port is open again after `attempts` attempts, at `time` [s, host's monotonic clock]."""

    time: float
    attempts: int


Arrival = Chunk | Lost | Restored


class SerialPort:
    """A port that is read continuously from `open` to `close`.

    Args:
        url: device or pyserial URL.
        baudrate: [bit/s].
        clock: the host's.

    Attributes:
        dropped: bytes that were thrown away because `take` stayed away.
        attempts: to open a port that has gone, since it went.
        read_until: until when what arrived has been handed on [s, host's monotonic clock].
    """

    def __init__(self, url: str, baudrate: int, clock: Clock = SYSTEM_CLOCK) -> None:
        self.url = url
        self.dropped = 0
        self.attempts = 0
        self.read_until = -math.inf
        self._baudrate = baudrate
        self._clock = clock
        self._arrivals: deque[Arrival] = deque()
        self._waiting = 0
        self._changed = clock.condition()
        self._closing = clock.event()
        self._thread: threading.Thread | None = None

    def open(self) -> None:
        """Open the port and begin to read.

        Raises:
            ConnectionFailedError: no such device, no permission, or it is in use.
            UsageError: not a URL, or a baud rate that the port does not have.
        """
        port = open_port(self.url, self._baudrate, READ_TIMEOUT)
        self.clear()
        self._closing = self._clock.event()
        self._thread = self._clock.thread(self._run, f"thermometer {self.url}", (port, self._closing))
        self._thread.start()

    def take(self, timeout: float) -> list[Arrival]:
        """What has arrived since the last call, waiting at most `timeout` [s] for the first."""
        with self._changed:
            self._changed.wait_for(lambda: self._arrivals, timeout)
            arrivals = list(self._arrivals)
            self._arrivals.clear()
            self._waiting = 0
        return arrivals

    def clear(self) -> None:
        """Forget what has arrived."""
        with self._changed:
            self._arrivals.clear()
            self._waiting = 0

    def close(self) -> None:
        """Let go of the port; safe at any time."""
        self._closing.set()
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.join(CLOSE_LIMIT)  # an attempt to connect may take longer; the thread closes what it gets then

    def _run(self, port: serial.SerialBase, closing: threading.Event) -> None:
        try:
            while not closing.is_set():
                why = self._read_until_lost(port, closing)
                with contextlib.suppress(Exception):
                    port.close()
                if closing.is_set():
                    return
                self._put(Lost(self._clock.now(), why))
                reopened = self._open_again(closing)
                if reopened is None:
                    return
                port = reopened
        finally:
            with contextlib.suppress(Exception):
                port.close()

    def _read_until_lost(self, port: serial.SerialBase, closing: threading.Event) -> str:
        since = self._clock.now()
        while not closing.is_set():
            try:
                data = port.read(CHUNK_BYTES)
            except Exception as error:  # OSError, termios.error, and whatever protocols' modules raise
                return reason(error)
            until = self._clock.now()
            if data:
                self._put(Chunk(bytes(data), since, until))
            self.read_until = since = until
        return ""

    def _open_again(self, closing: threading.Event) -> serial.SerialBase | None:
        self.attempts = 0
        while not closing.wait(RETRY_PERIOD):
            self.attempts += 1
            with contextlib.suppress(Exception):  # whatever it is, the next attempt may succeed
                port = open_port(self.url, self._baudrate, READ_TIMEOUT)
                self._put(Restored(self._clock.now(), self.attempts))
                return port
        return None

    def _put(self, arrival: Arrival) -> None:
        with self._changed:
            if isinstance(arrival, Chunk):
                self._waiting += len(arrival.data)
                while self._waiting > BUFFER_BYTES:
                    oldest = next(item for item in self._arrivals if isinstance(item, Chunk))
                    self._arrivals.remove(oldest)
                    self._waiting -= len(oldest.data)
                    self.dropped += len(oldest.data)
            self._arrivals.append(arrival)
            self._changed.notify()
