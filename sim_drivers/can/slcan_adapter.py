"""A simulated CAN adapter on a pseudo-terminal: Lawicel's ASCII protocol ("slcan") in front of a python-can bus."""

from __future__ import annotations

import contextlib
import errno
import os
import re
from collections import deque
from collections.abc import Callable, Mapping

import can
import numpy as np

from drivers.core.clock import SYSTEM_CLOCK, Clock
from sim_drivers.pseudo_terminal import PseudoTerminal
from sim_drivers.server import Server

BITRATES = (10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)
"""[bit/s] of the commands S0 to S8."""
OK, REFUSED = b"\r", b"\a"
VERSION, SERIAL_NUMBER = b"V1013\r", b"NA402\r"
LONGEST_COMMAND = 40
"""[byte]: the longest command is that of an extended frame, 27."""
BACKLOG_LIMIT = 65536
"""Bytes that are queued for a host that does not read, as in the kernel's serial buffers; later ones are lost."""
OVERRUN, BUS_ERROR = 0x08, 0x80
"""Bits of the status flags (command F)."""
POLL = 0.02
STAMP_PERIOD = 60_000
"""Time stamps count milliseconds up to here."""

_FRAME = re.compile(rb"([tr])([0-9A-Fa-f]{3})([0-8])([0-9A-Fa-f]*)|([TR])([0-9A-Fa-f]{8})([0-8])([0-9A-Fa-f]*)")


def parse_frame(command: bytes) -> can.Message | None:
    """The frame of a t, T, r or R command; None where it is none."""
    match = _FRAME.fullmatch(command)
    if match is None:
        return None
    kind, identifier, length, data = match.groups()[:4] if match[1] else match.groups()[4:]
    extended, remote = kind in b"TR", kind in b"rR"
    size = int(length)
    if len(data) != (0 if remote else 2 * size) or int(identifier, 16) >= (1 << 29 if extended else 1 << 11):
        return None
    return can.Message(
        arbitration_id=int(identifier, 16),
        is_extended_id=extended,
        is_remote_frame=remote,
        dlc=size,
        data=bytes.fromhex(data.decode()),
    )


def format_frame(message: can.Message, stamp: int | None = None) -> bytes:
    """Message of the adapter for a received frame, with a time stamp [ms] where it has one."""
    letter = "r" if message.is_remote_frame else "t"
    identifier = f"{message.arbitration_id:03X}"
    if message.is_extended_id:
        letter, identifier = letter.upper(), f"{message.arbitration_id:08X}"
    data = "" if message.is_remote_frame else bytes(message.data).hex().upper()
    tail = "" if stamp is None else f"{stamp:04X}"
    return f"{letter}{identifier}{message.dlc}{data}{tail}\r".encode()


class SlcanAdapter(Server):
    """An adapter that `start` plugs in and `stop` closes.

    An adapter set to another bit rate than that of the bus behind it gets nothing across.
    """

    def __init__(
        self, bus: can.BusABC, bitrate: int = 1_000_000, port: PseudoTerminal | None = None, clock: Clock = SYSTEM_CLOCK
    ) -> None:
        super().__init__(clock)
        self._bus = bus
        self._bitrate = bitrate
        self._port = PseudoTerminal() if port is None else port
        self.path = self._port.path
        """The serial port that a client opens."""
        self._lock = clock.lock()
        self._backlog = bytearray()
        self._plugged = False
        self._channel_open = self._listen_only = self._stamped = False
        self._setting: int | None = None
        self._flags = 0
        self._truncate = 0
        self._generator = np.random.default_rng(0)
        self.lost = 0
        """Frames that the host did not read in time."""

    def _work(self) -> Mapping[str, Callable[[], None]]:
        return {"slcan-commands": self._serve_host, "slcan-frames": self._serve_bus}

    def _open(self) -> None:
        self._port.plug_in()
        self._plugged = True

    def _close(self) -> None:
        self.unplug()
        self._port.remove()
        with contextlib.suppress(can.CanError):
            self._bus.shutdown()

    def unplug(self) -> None:
        """Unplug it: the port disappears for good; from any thread."""
        with self._lock:
            if self._plugged:
                self._plugged = False
                self._port.pull_out()

    def truncate(self, lines: int) -> None:
        """Cut the next lines of received frames short."""
        self._truncate += lines

    def garbage(self, lines: int) -> None:
        """Send lines of rubbish."""
        for _ in range(lines):
            self._send(self._generator.bytes(int(self._generator.integers(1, 30))) + OK)

    # Towards the host.

    def _send(self, content: bytes) -> bool:
        """Queue bytes for the host; False where it has left too many unread."""
        with self._lock:
            if not self._plugged or len(self._backlog) + len(content) > BACKLOG_LIMIT:
                return False
            self._backlog += content
            self._flush()
            return True

    def _flush(self) -> None:
        while self._backlog:
            try:
                written = os.write(self._port.fileno(), self._backlog)
            except BlockingIOError:
                return
            except OSError as error:
                if error.errno == errno.EIO:  # no client has the port open
                    self._backlog.clear()
                    return
                raise
            del self._backlog[:written]

    def _serve_bus(self) -> None:
        while not self._stopping.is_set() and self._plugged:
            message = self._bus.recv(POLL)
            if message is not None and message.is_error_frame:
                self._flags |= BUS_ERROR
            elif message is None or not self._channel_open or message.is_fd:
                continue
            elif self._setting not in (None, self._bitrate):
                self._flags |= BUS_ERROR
            else:
                self._pass_on(message)

    def _pass_on(self, message: can.Message) -> None:
        stamp = int(1e3 * self._clock.now()) % STAMP_PERIOD if self._stamped else None
        line = format_frame(message, stamp)
        if self._truncate > 0 and len(message.data) > 1:
            self._truncate -= 1
            line = line[:-3] + OK  # as many data bytes as the length says, but one
        if not self._send(line):
            self._flags |= OVERRUN
            self.lost += 1

    # From the host.

    def _serve_host(self) -> None:
        received = bytearray()
        commands: deque[bytes] = deque()
        while not self._stopping.is_set() and self._plugged:
            chunk = self._read()
            for text in re.split(rb"(\r)", chunk):
                if text == OK:
                    commands.append(bytes(received))
                    received.clear()
                elif len(received) <= LONGEST_COMMAND:
                    received += text[: LONGEST_COMMAND + 1]
            while commands:
                self._send(self._answer(commands.popleft()))

    def _read(self) -> bytes:
        try:
            with self._lock:
                writers = [self._port] if self._backlog and self._plugged else []
            readable, writable = self._clock.select([self._port], writers, POLL)
            if writable:
                with self._lock:
                    if self._plugged:
                        self._flush()
            with self._lock:
                return os.read(self._port.fileno(), 4096) if readable and self._plugged else b""
        except (OSError, ValueError):
            # Pulled out, or no client has the port open.
            self._stopping.wait(POLL)
            return b""

    def _answer(self, command: bytes) -> bytes:
        """Obey one command (Lawicel CAN232 manual, version 3) and answer it."""
        match command[:1], command[1:]:
            case b"", _:
                return OK
            case b"S", digit if not self._channel_open and digit in [b"%d" % index for index in range(len(BITRATES))]:
                self._setting = BITRATES[int(digit)]
                return OK
            case (b"O" | b"L") as letter, b"" if not self._channel_open:
                self._channel_open, self._listen_only, self._flags = True, letter == b"L", 0
                return OK
            case b"C", b"" if self._channel_open:
                self._channel_open = False
                return OK
            case ((b"t" | b"T" | b"r" | b"R"), _) if self._channel_open and not self._listen_only:
                message = parse_frame(command)
                if message is None:
                    return REFUSED
                if self._setting not in (None, self._bitrate):
                    self._flags |= BUS_ERROR
                    return REFUSED
                self._bus.send(message)
                return b"Z\r" if message.is_extended_id else b"z\r"
            case b"F", b"" if self._channel_open:
                flags, self._flags = self._flags, 0
                return b"F%02X\r" % flags
            case b"V", b"":
                return VERSION
            case b"N", b"":
                return SERIAL_NUMBER
            case b"Z", (b"0" | b"1") as digit if not self._channel_open:
                self._stamped = digit == b"1"
                return OK
        return REFUSED
