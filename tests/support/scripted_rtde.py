"""An RTDE controller that follows a test's script exactly, written without drivers.rtde."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from simulated_clock import SimulatedClock

TYPES = {
    "timestamp": ("DOUBLE", ">d"),
    **dict.fromkeys(
        ("actual_q", "actual_qd", "actual_current", "target_q", "target_qd", "target_qdd", "target_current")
        + ("target_moment", "joint_temperatures"),
        ("VECTOR6D", ">6d"),
    ),
    "robot_mode": ("INT32", ">i"),
    "safety_mode": ("INT32", ">i"),
    "runtime_state": ("UINT32", ">I"),
    "joint_mode": ("VECTOR6INT32", ">6i"),
}


@dataclass(frozen=True)
class Sample:
    """A data package at a controller time; `values` replace those of `default_values`."""

    time: float
    values: Mapping[str, Sequence[float]] = ()  # type: ignore[assignment]


@dataclass(frozen=True)
class Wait:
    seconds: float


@dataclass(frozen=True)
class Text:
    level: int
    source: str
    text: str


class Cut:
    """Close the connection."""


class Never:
    """Send nothing more, but keep the connection."""


Step = Sample | Wait | Text | Cut | Never | bytes


def default_values(clock: float) -> dict[str, Sequence[float]]:
    """Values that encode their time: joint j of every vector is clock + j/10, times a factor."""
    vector = [clock + joint / 10 for joint in range(6)]
    return {
        "timestamp": [clock],
        "actual_q": vector,
        "actual_qd": [2 * value for value in vector],
        "actual_current": [3 * value for value in vector],
        "target_q": [4 * value for value in vector],
        "target_qd": [5 * value for value in vector],
        "target_qdd": [6 * value for value in vector],
        "target_current": [7 * value for value in vector],
        "target_moment": [8 * value for value in vector],
        "joint_temperatures": [9 * value for value in vector],
        "robot_mode": [7],
        "safety_mode": [1],
        "runtime_state": [1],
        "joint_mode": [253] * 6,
    }


def steady(start: float, count: int, rate: float = 500.0) -> list[Step]:
    """Samples at a controller's pace, sent as fast as they go."""
    return [Sample(start + index / rate) for index in range(count)]


def paced(rate: float, start: float = 10.0) -> Iterable[Step]:
    """Samples at a controller's pace, without end."""
    index = 0
    while True:
        yield Sample(start + index / rate)
        yield Wait(1.0 / rate)
        index += 1


def package(kind: str, payload: bytes) -> bytes:
    return struct.pack(">HB", 3 + len(payload), ord(kind)) + payload


class ScriptedController:
    """Serves connections, each in a thread of a simulated clock; `script(number)`: what number `number` (from 0) sends.

    Attributes:
        connections: how many there were.
        pauses: how many were asked for.
        asked: rate and variables of every recipe.
    """

    def __init__(
        self,
        clock: SimulatedClock,
        script: Callable[[int], Iterable[Step]],
        *,
        major: int = 5,
        refuse: Mapping[str, str] | None = None,
        types: Mapping[str, str] | None = None,
        accept_protocol: bool = True,
        mute_at: str = "",
        greeting: bytes = b"",
        chatter: bytes = b"",
    ) -> None:
        self.script = script
        self.major, self.refuse, self.types = major, dict(refuse or {}), dict(types or {})
        self.accept_protocol, self.mute_at, self.greeting, self.chatter = accept_protocol, mute_at, greeting, chatter
        self.connections = 0
        self.pauses = 0
        self.asked: list[tuple[float, list[str]]] = []
        self._clock = clock
        self._open: list[socket.socket] = []
        self._threads: list[threading.Thread] = []

    def connect(self, host: str, port: int, timeout: float) -> socket.socket:
        """A new connection, whatever the address."""
        ours, theirs = socket.socketpair()
        self._open.append(theirs)
        number, self.connections = self.connections, self.connections + 1
        self._start(self._serve, theirs, number)
        return ours

    def send(self, content: bytes) -> None:
        """Send at once to whom connected last, before anybody else runs."""
        self._open[-1].sendall(content)

    def close(self) -> None:
        for connection in self._open:
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)
        for thread in self._threads:
            thread.join()
        for connection in self._open:
            connection.close()

    def _start(self, target: Callable[..., object], *args: object) -> threading.Thread:
        thread = self._clock.thread(target, target.__name__, args)
        self._threads.append(thread)
        thread.start()
        return thread

    def _serve(self, connection: socket.socket, number: int) -> None:
        variables: list[str] = []
        paused = self._clock.event()
        sending: threading.Thread | None = None
        received = b""
        try:
            self._send(connection, self.greeting)
            while True:
                if not self._clock.select([connection], [], 0.05 if self.chatter else 60.0)[0]:
                    self._send(connection, self.chatter)
                    continue
                chunk = connection.recv(65536)
                if not chunk:
                    return
                received += chunk
                while len(received) >= 3 and len(received) >= (size := struct.unpack(">H", received[:2])[0]):
                    kind, payload, received = chr(received[2]), received[3:size], received[size:]
                    if kind == self.mute_at:
                        continue
                    if kind == "O":
                        variables = payload[8:].decode().split(",")
                        self.asked.append((struct.unpack(">d", payload[:8])[0], variables))
                    if kind == "P":
                        self.pauses += 1
                        paused.set()
                        if sending is not None:
                            sending.join()
                    self._send(connection, self._answer(kind, variables))
                    if kind == "S":
                        paused.clear()
                        sending = self._start(self._play, connection, number, variables, paused)
        except OSError:
            return
        finally:
            paused.set()

    def _answer(self, kind: str, variables: Sequence[str]) -> bytes:
        if kind == "V":
            return package("V", bytes([self.accept_protocol]))
        if kind == "v":
            return package("v", struct.pack(">4I", self.major, 22, 0, 0))
        if kind == "O":
            types = [self.types.get(name) or self.refuse.get(name) or TYPES[name][0] for name in variables]
            return package("O", bytes([1]) + (",".join(types) + ",").encode())
        return package(kind, b"\1")

    def _play(self, connection: socket.socket, number: int, variables: list[str], paused: threading.Event) -> None:
        try:
            for step in self.script(number):
                if paused.is_set():
                    return
                if isinstance(step, bytes):
                    self._send(connection, step)
                elif isinstance(step, Wait):
                    paused.wait(step.seconds)
                elif isinstance(step, Text):
                    text, source = step.text.encode(), step.source.encode()
                    body = bytes([len(text)]) + text + bytes([len(source)]) + source + bytes([step.level])
                    self._send(connection, package("M", body))
                elif isinstance(step, Cut):
                    connection.shutdown(socket.SHUT_RDWR)
                    return
                elif isinstance(step, Never):
                    paused.wait()
                    return
                else:
                    self._send(connection, data_package(variables, step))
        except OSError:
            return

    def _send(self, connection: socket.socket, content: bytes) -> None:
        while content:
            self._clock.select([], [connection], 60.0)
            content = content[connection.send(content) :]


def data_package(variables: Sequence[str], sample: Sample) -> bytes:
    values = default_values(sample.time) | dict(sample.values)
    return package("U", b"\1" + b"".join(struct.pack(TYPES[name][1], *values[name]) for name in variables))
