"""Both ends of an RTDE connection for tests: a served arm in its own process, ur_rtde in another, and a bare socket."""

from __future__ import annotations

import itertools
import json
import os
import socket
import struct
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import numpy.typing as npt

from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.rtde import protocol as wire

LIMIT = 60.0
"""Time [s] after which a step counts as hung."""
ROOT = Path(__file__).resolve().parents[2]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
_numbers = itertools.count(1)


def loopback() -> str:
    """An address of this computer that no other test uses now: clients such as ur_rtde use only one port."""
    return f"127.{20 + os.getpid() % 200}.{os.getpid() // 200 % 250}.{next(_numbers)}"


@contextmanager
def served(*command: str) -> Iterator[tuple[dict[str, object], subprocess.Popen[str]]]:
    """A served arm in its own process: its message when it was ready, and the process, which accepts faults."""
    process = subprocess.Popen(
        [sys.executable, *command],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
        env=ENVIRONMENT,
    )
    assert process.stdout is not None
    try:
        line = process.stdout.readline()
        assert line, process.stderr.read() if process.stderr else ""
        yield json.loads(line), process
    finally:
        process.terminate()
        process.communicate(timeout=LIMIT)


def ur_rtde(code: str, *hosts: str) -> dict[str, object]:
    """Run a program of ur_rtde in its own process, where it may hang; it fills the dictionary `out`.

    It may `wait` for a condition, for as long as the whole program may take.
    """
    program = (
        "import json, math, sys, time\n"
        "import numpy as np\n"
        "from rtde_receive import RTDEReceiveInterface as Receive\n"
        "from rtde_control import RTDEControlInterface as Control\n"
        "from rtde_io import RTDEIOInterface as IO\n"
        "hosts, out = sys.argv[1:], {}\n"
        "def wait(condition):\n"
        "    while not condition():\n"
        "        time.sleep(0.002)\n"
        f"{textwrap.dedent(code)}\n"
        "print('OUT' + json.dumps(out))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, *hosts], capture_output=True, text=True, timeout=LIMIT, env=ENVIRONMENT
    )
    lines = [line for line in done.stdout.splitlines() if line.startswith("OUT")]
    assert lines, done.stdout + done.stderr
    result = json.loads(lines[-1][3:])
    assert isinstance(result, dict)
    return result


class BareClient:
    """A connected socket with RTDE as in UR's own Python client does: no comma behind the last name."""

    def __init__(self, sock: socket.socket, clock: Clock = SYSTEM_CLOCK, *, greet: bool = True) -> None:
        self.sock = sock
        self._clock = clock
        self._splitter = wire.PackageSplitter()
        self._received: list[wire.Package] = []
        if greet:
            assert self.ask(wire.REQUEST_PROTOCOL_VERSION, struct.pack(">H", 2)) == b"\x01"

    def __enter__(self) -> BareClient:
        return self

    def __exit__(self, *_: object) -> None:
        self.sock.close()

    def send(self, kind: int, payload: bytes = b"") -> None:
        self.sock.sendall(wire.encode_package(kind, payload))

    def next(self, seconds: float = LIMIT) -> wire.Package:
        """The next package; EOFError where the server hung up, TimeoutError where nothing comes for so long [s]."""
        while not self._received:
            if not self._clock.select([self.sock], [], seconds)[0]:
                raise TimeoutError
            chunk = self.sock.recv(65536)
            if not chunk:
                raise EOFError
            self._received += self._splitter.feed(chunk)
        return self._received.pop(0)

    def ask(self, kind: int, payload: bytes = b"") -> bytes:
        """The answer to a request; data packages before it are passed over."""
        self.send(kind, payload)
        while (package := self.next()).kind != kind:
            pass
        return package.payload

    def types(self, kind: int, names: Sequence[str], rate: float = 500.0) -> tuple[int, list[str]]:
        """Number and types that a recipe was answered with."""
        head = struct.pack(">d", rate) if kind == wire.SETUP_OUTPUTS else b""
        answer = self.ask(kind, head + ",".join(names).encode())
        return answer[0], answer[1:].decode().split(",")

    def stream(self, names: Sequence[str], rate: float = 500.0) -> None:
        """Make data packages come."""
        number, types = self.types(wire.SETUP_OUTPUTS, names, rate)
        self._recipe = wire.Recipe(number, tuple(zip(names, types, strict=True)))
        assert self.ask(wire.START) == b"\x01"

    def row(self) -> npt.NDArray[np.void]:
        """The next data package, decoded."""
        while (package := self.next()).kind != wire.DATA_PACKAGE:
            pass
        decoded: npt.NDArray[np.void] = wire.decode_data(self._recipe, package.raw)[0]
        return decoded

    def until(
        self, condition: Callable[[npt.NDArray[np.void]], object], seconds: float = LIMIT
    ) -> npt.NDArray[np.void]:
        """The first row that fulfils a condition."""
        end = self._clock.now() + seconds
        while self._clock.now() < end:
            if condition(row := self.row()):
                return row
        raise AssertionError("it did not happen")


def connected(host: str) -> BareClient:
    """A client of a controller's RTDE port, in real time."""
    return BareClient(socket.create_connection((host, wire.PORT), timeout=LIMIT))
