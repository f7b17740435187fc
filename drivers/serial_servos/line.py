"""The half-duplex line of serial servos: one request at a time, its answers, and what else is heard."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.core.clock import LATE, SYSTEM_CLOCK, Clock
from drivers.core.errors import ConnectionLostError
from drivers.serial_port import BITS_A_BYTE, open_port, reason
from drivers.serial_servos.packets import Packet, ServoProtocol

READ_SLICE = 0.002
"""[s] that one reading of the port waits at most."""
PATIENCE = 0.03
"""[s] beyond the time on the wire that answers are waited for, until it is known how long they take: more than the
16 ms of an adapter's latency timer."""
LEAST_PATIENCE = 0.01
"""[s]: where answers come at once, one that is lost must not cost much more than its period."""
UNHURRIED = 0.1
"""[s] that the answer of a single servo is waited for, where no cycle hangs on it: a computer may be busy."""
QUIET = 0.003
"""[s] without a byte after which nothing more is on its way, …"""
LONGEST_DRAIN = 0.02
"""… or so long [s] after an answer that did not come."""
HICCUP = 0.001
"""[s] that a look at the port may be late, and what it finds counts as come just then."""
LATENCY_TIMER = Path("/sys/bus/usb-serial/devices")
"""Where Linux shows the latency timers of USB adapters."""


@dataclass(frozen=True)
class Heard:
    """What came after a request."""

    answers: Sequence[Packet]  # whole ones, in the order in which they came
    strange: int  # bytes that belonged to none
    # sent, received: when the request went out and when the last answer was complete [s, host's monotonic clock]
    sent: float
    received: float


class ServoLine:
    """A serial port on which servos answer; not for more than one thread at a time.

    Whatever exchanges bytes raises ConnectionLostError where the port is gone.

    Attributes:
        echo: whether the adapter returns what is sent; found out by `notice_echo`.
        patience: beyond the time on the wire that the answers of a cycle are waited for [s].
    """

    def __init__(self, url: str, baudrate: int, protocol: ServoProtocol, clock: Clock = SYSTEM_CLOCK) -> None:
        self.url, self.baudrate, self.protocol = url, baudrate, protocol
        self.echo = False
        self.patience = PATIENCE
        self._clock = clock
        self._answering = 0.0
        self._port: Any = None

    def open(self) -> None:
        """Open the port, for this program alone.

        Raises:
            ConnectionFailedError: no such device, no permission, or it is in use.
            UsageError: not a URL, or a baud rate that the port does not have.
        """
        self._port = open_port(self.url, self.baudrate, READ_SLICE, write_timeout=1.0)
        with contextlib.suppress(Exception):  # only some adapters and systems have it
            self._port.set_low_latency_mode(True)

    def close(self) -> None:
        """Let go of the port; safe at any time."""
        port, self._port = self._port, None
        if port is not None:
            with contextlib.suppress(Exception):
                port.close()

    def send(self, request: bytes) -> None:
        """Send what is not answered."""
        self._write(request)
        if self.echo:
            self._read(len(request), self._clock.now() + self._wire_time(len(request)) + self.patience)

    def exchange(self, request: bytes, answer_bytes: int, motors: Collection[int], *, hurried: bool = True) -> Heard:
        """Send a request, and wait until all servos of these ids have answered, or nothing more can come.

        Where one is missing, what may still be on its way is thrown away: it would be taken for the next answer. The
        bytes are those of all answers together. One servo may be waited for without hurry. Time in which this process
        did not run is none of waiting; what came meanwhile is stamped as if it had come in the usual time.
        """
        sent = received = looked = self._send_promptly(request)
        skipped = len(request) if self.echo else 0
        on_wire = self._wire_time(len(request) + skipped + answer_bytes)
        end = sent + on_wire + (self.patience if hurried else UNHURRIED)
        buffer, answers, strange = bytearray(), list[Packet](), 0
        missing = skipped + answer_bytes
        over = False
        while (waiting := not {answer.motor for answer in answers}.issuperset(motors)) and not over:
            data = self._read_some(max(missing, 1))
            missing -= len(data)
            before, looked = looked, self._clock.now()
            late = self._clock.late(before + READ_SLICE)
            end += late
            over = looked >= end
            if not data:
                continue
            received = looked if late < HICCUP else min(max(before, sent + on_wire + self._answering), looked)
            buffer += data
            if skipped:
                cut = min(skipped, len(buffer))
                del buffer[:cut]
                skipped -= cut
            found, more = self.protocol.answers(buffer)
            answers += found
            strange += more
        if waiting:
            self._drain()
        elif hurried:
            self._answering = received - sent - on_wire
        return Heard(answers, strange + len(buffer), sent, received)

    def notice_echo(self, request: bytes, answer_bytes: int) -> Heard:
        """Send a request that one servo answers, and see whether the adapter returns it before the answer."""
        self._write(request)
        sent = self._clock.now()
        end = sent + self._wire_time(2 * len(request) + answer_bytes) + UNHURRIED
        data = bytearray()
        while len(data) < len(request) + answer_bytes and self._clock.now() < end:
            data += self._read_some(len(request) + answer_bytes - len(data))
            if not data.startswith(request[: len(data)]) and len(data) >= answer_bytes:
                break
        # Without an echo an answer could look like its request only by chance: they differ in length or parameters.
        echoed = data.startswith(request)
        self.echo = self.echo or echoed
        if echoed:
            del data[: len(request)]
        answers, strange = self.protocol.answers(data)
        if not answers:
            self._drain()
        return Heard(answers, strange + len(data), sent, self._clock.now())

    def latency_timer(self) -> int | None:
        """Return how long [ms] the USB adapter collects bytes before it hands them on; None where it does not say."""
        name = os.path.basename(os.path.realpath(self.url))
        try:
            return int((LATENCY_TIMER / name / "latency_timer").read_text("ascii"))
        except (OSError, ValueError):
            return None

    def _wire_time(self, count: int) -> float:
        return count * BITS_A_BYTE / self.baudrate

    def _send_promptly(self, request: bytes) -> float:
        """Send a request; when [s]. Where this process stalled meanwhile, that is unknown: it is sent again."""
        begun = self._clock.now()
        self._write(request)
        if self._clock.now() - begun > LATE:
            self._drain()
            self._write(request)
        return self._clock.now()

    def _write(self, data: bytes) -> None:
        port = self._opened()
        try:
            port.reset_input_buffer()  # what came late belongs to no request any more
            port.write(data)
        except Exception as error:
            raise self._lost(error) from error

    def _drain(self) -> None:
        now = self._clock.now()
        end, quiet = now + LONGEST_DRAIN, now + QUIET
        while self._clock.now() < min(end, quiet):
            if self._read_some(4096):
                quiet = self._clock.now() + QUIET

    def _read(self, count: int, end: float) -> bytes:
        data = b""
        while len(data) < count and self._clock.now() < end:
            data += self._read_some(count - len(data))
        return data

    def _read_some(self, count: int) -> bytes:
        try:
            return bytes(self._opened().read(count))
        except ConnectionLostError:
            raise
        except Exception as error:  # OSError, termios.error, and whatever protocols' modules raise
            raise self._lost(error) from error

    def _opened(self) -> Any:
        if self._port is None:
            raise ConnectionLostError("the port is closed", where=self.url)
        return self._port

    def _lost(self, error: Exception) -> ConnectionLostError:
        return ConnectionLostError(f"the port is gone: {reason(error)}", where=self.url, hint="check its cable")
