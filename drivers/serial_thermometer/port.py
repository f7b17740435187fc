"""The port of a serial thermometer: a thread reads whole chunks, and opens the port again when it has gone."""

from __future__ import annotations

import contextlib
import math
import re
import threading
from collections import Counter, deque
from dataclasses import dataclass

import serial

from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.text import counted
from drivers.core.units import ZERO_CELSIUS
from drivers.serial_port import open_port, reason
from drivers.serial_thermometer.settings import ThermometerSettings

READ_TIMEOUT = 0.01
"""Longest time [s] that a chunk is collected."""
CHUNK_BYTES = 4096
BUFFER_BYTES = 1 << 20
"""What may wait for `take` before the oldest is dropped."""
RETRY_PERIOD = 1.0
"""[s] between two attempts to open a port that has gone."""
CLOSE_LIMIT = 2.0

LONGEST_LINE = 1024
"""Bytes; beyond, something else than lines is coming, and waiting for an end would fill the memory."""
MOST_UNKNOWN = 100
"""Channels that are remembered though the robot file does not name them."""
SHOWN = 40
"""Characters of a rejected line that a message quotes."""
_LINE_END = re.compile(rb"[\r\n]+")
_NUMBER = re.compile(r"\s*[+-]?(?:[0-9]+(?:[.,][0-9]*)?|[.,][0-9]+)(?:[eE][+-]?[0-9]+)?\s*")

NO_MATCH = "do not match the pattern"
NOT_A_NUMBER = "have no number for the value"
OUT_OF_RANGE = "have a temperature outside the accepted range"
TOO_LONG = f"are longer than {LONGEST_LINE} characters"
CUT = "were cut off"


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
        """Return what has arrived since the last call, waiting at most `timeout` [s] for the first."""
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


@dataclass(frozen=True)
class ThermometerReading:
    """One temperature."""

    end: int  # index of the byte at which its line ended, in the bytes last fed
    joint: str  # name
    value: float  # [°C]


class LineParser:
    """Cuts bytes into lines, lines into temperatures; what is no temperature is counted.

    Attributes:
        rejected: why → how many lines, since the last `take_rejected`.
        last_rejected: the beginning of the last one.
        unknown: channels that the robot file does not name, seen so far.
    """

    def __init__(self, settings: ThermometerSettings) -> None:
        self._settings = settings
        self._rest = b""
        self._skipping = True
        self.rejected: Counter[str] = Counter()
        self.last_rejected = ""
        self.unknown: set[str] = set()

    def restart(self, *, cut: bool = False) -> None:
        """Begin anew in the middle of a line: what comes before its end is dropped; `cut` counts what was there."""
        if cut and self._rest:
            self._reject(CUT, self._rest)
        self._rest, self._skipping = b"", True

    def feed(self, data: bytes) -> list[ThermometerReading]:
        """Temperatures of the lines that end within `data`, in their order."""
        readings: list[ThermometerReading] = []
        start = 0
        for end in _LINE_END.finditer(data):
            line = self._rest + data[start : end.start()]
            self._rest, start = b"", end.end()
            if self._skipping:  # the first piece may be the end of a line: "12=20" would be read as "2=20"
                self._skipping = False
            elif len(line) > LONGEST_LINE:
                self._reject(TOO_LONG, line)
            elif line.strip():
                readings.extend(self._parse(line, end.start()))
        self._rest += data[start:]
        if len(self._rest) > LONGEST_LINE:
            if not self._skipping:
                self._reject(TOO_LONG, self._rest)
            self._rest, self._skipping = b"", True
        return readings

    def take_rejected(self) -> str:
        """The lines rejected since the last call, in words; empty where there are none."""
        if not self.rejected:
            return ""
        reasons = ", ".join(f"{count} {why}" for why, count in self.rejected.most_common())
        total = sum(self.rejected.values())
        self.rejected.clear()
        return f"{counted(total, 'line')} ignored: {reasons}; the last one: {self.last_rejected!r}"

    def _parse(self, line: bytes, end: int) -> list[ThermometerReading]:
        text = line.decode("ascii", "replace")
        readings: list[ThermometerReading] = []
        trouble = NO_MATCH
        for number, match in enumerate(self._settings.pattern.finditer(text)):
            trouble = trouble if number else ""
            channel, value = match["channel"] or "", self._celsius(match["value"])
            joint = self._settings.channels.get(channel)
            if joint is None:
                if len(self.unknown) < MOST_UNKNOWN:  # garbage may invent channels
                    self.unknown.add(channel)
            elif value is None:
                trouble = NOT_A_NUMBER  # of this sensor; the others of the line still count
            elif not self._settings.range[0] <= value <= self._settings.range[1]:
                trouble = OUT_OF_RANGE
            else:
                readings.append(ThermometerReading(end, joint, value))
        if trouble:
            self._reject(trouble, line)
        return readings

    def _celsius(self, written: str | None) -> float | None:
        if written is None or _NUMBER.fullmatch(written) is None:
            return None
        value = float(written.replace(",", "."))  # a point or a comma, and at most one
        if self._settings.unit == "degF":
            return (value - 32.0) / 1.8
        return value - ZERO_CELSIUS if self._settings.unit == "K" else value

    def _reject(self, why: str, line: bytes) -> None:
        self.rejected[why] += 1
        self.last_rejected = line[:SHOWN].decode("ascii", "replace")
