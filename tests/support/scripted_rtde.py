"""A controller that speaks RTDE and does exactly what a test's script says, written without drivers.rtde."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

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
    """A data package at a controller time; `values` replaces what `default_values` gives."""

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
    """Say nothing more, but keep the connection."""


Step = Sample | Wait | Text | Cut | Never | bytes


def default_values(clock: float) -> dict[str, Sequence[float]]:
    """Values that tell when they were true: joint j of every vector is clock + j/10, times a factor."""
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
        "runtime_state": [2],
        "joint_mode": [253] * 6,
    }


def steady(start: float, count: int, rate: float = 500.0) -> list[Step]:
    """Samples at a controller's pace, sent as fast as they go."""
    return [Sample(start + index / rate) for index in range(count)]


def package(kind: str, payload: bytes) -> bytes:
    return struct.pack(">HB", 3 + len(payload), ord(kind)) + payload


class ScriptedController:
    """Serves connections one after the other; `script(number)`: what connection `number` (from 0) sends."""

    def __init__(
        self,
        script: Callable[[int], Iterable[Step]],
        *,
        major: int = 5,
        refuse: Mapping[str, str] | None = None,
        types: Mapping[str, str] | None = None,
        accept_protocol: bool = True,
        mute_at: str = "",
        greeting: bytes = b"",
        host: str = "127.0.0.1",
        port: int = 0,
    ) -> None:
        self.script = script
        self.major, self.refuse, self.types = major, dict(refuse or {}), dict(types or {})
        self.accept_protocol, self.mute_at, self.greeting = accept_protocol, mute_at, greeting
        self.connections = 0
        self.pauses = 0
        self.asked: list[tuple[float, list[str]]] = []
        self._ended = threading.Event()
        self._listener = socket.create_server((host, port))
        self.port: int = self._listener.getsockname()[1]
        self._open: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        self._ended.set()
        for connection in [self._listener, *self._open]:
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)
            connection.close()

    def _accept(self) -> None:
        while not self._ended.is_set():
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._open.append(connection)
            number, self.connections = self.connections, self.connections + 1
            threading.Thread(target=self._serve, args=(connection, number), daemon=True).start()

    def _serve(self, connection: socket.socket, number: int) -> None:
        variables: list[str] = []
        paused = threading.Event()
        sending: threading.Thread | None = None
        try:
            connection.sendall(self.greeting)
            stream = connection.makefile("rb")
            while header := stream.read(3):
                size, kind_number = struct.unpack(">HB", header)
                kind, payload = chr(kind_number), stream.read(size - 3)
                if kind == self.mute_at:
                    continue
                if kind == "V":
                    connection.sendall(package("V", bytes([self.accept_protocol])))
                elif kind == "v":
                    connection.sendall(package("v", struct.pack(">4I", self.major, 22, 0, 0)))
                elif kind == "O":
                    variables = payload[8:].decode().split(",")
                    self.asked.append((struct.unpack(">d", payload[:8])[0], variables))
                    types = [self.types.get(n) or self.refuse.get(n) or TYPES[n][0] for n in variables]
                    connection.sendall(package("O", bytes([1]) + (",".join(types) + ",").encode()))
                elif kind == "S":
                    connection.sendall(package("S", b"\1"))
                    paused.clear()
                    sending = threading.Thread(target=self._send, args=(connection, number, variables, paused))
                    sending.daemon = True
                    sending.start()
                elif kind == "P":
                    self.pauses += 1
                    paused.set()
                    if sending is not None:
                        sending.join()
                    connection.sendall(package("P", b"\1"))
        except OSError:
            return

    def _send(self, connection: socket.socket, number: int, variables: list[str], paused: threading.Event) -> None:
        try:
            for step in self.script(number):
                if paused.is_set() or self._ended.is_set():
                    return
                if isinstance(step, bytes):
                    connection.sendall(step)
                elif isinstance(step, Wait):
                    if paused.wait(step.seconds):
                        return
                elif isinstance(step, Text):
                    text, source = step.text.encode(), step.source.encode()
                    body = bytes([len(text)]) + text + bytes([len(source)]) + source + bytes([step.level])
                    connection.sendall(package("M", body))
                elif isinstance(step, Cut):
                    connection.shutdown(socket.SHUT_RDWR)
                    connection.close()
                    return
                elif isinstance(step, Never):
                    paused.wait()
                    return
                else:
                    connection.sendall(data_package(variables, step))
        except OSError:
            return


def data_package(variables: Sequence[str], sample: Sample) -> bytes:
    values = default_values(sample.time) | dict(sample.values)
    return package("U", b"\1" + b"".join(struct.pack(TYPES[name][1], *values[name]) for name in variables))


def paced(rate: float, start: float = 10.0) -> Iterable[Step]:
    """Samples in real time, without end."""
    begun = time.monotonic()
    index = 0
    while True:
        late = begun + index / rate - time.monotonic()
        if late > 0:
            time.sleep(late)
        yield Sample(start + index / rate)
        index += 1


def main() -> None:
    """Serve a paced controller until the standard input closes; print the port."""
    import sys

    controller = ScriptedController(lambda number: paced(float(sys.argv[1])))
    print(controller.port, flush=True)
    sys.stdin.read()


if __name__ == "__main__":
    main()
