"""A simulated controller, the driver and its motion in one process, joined by sockets that deliver at once."""

from __future__ import annotations

import contextlib
import socket
import struct
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import recorded_session
from simulated_clock import SimulatedClock

from daq.robot.schema import Robot
from daq.session.connections import driver_settings
from drivers.core.arrays import FloatArray
from drivers.rtde import protocol as wire
from drivers.rtde.driver import RtdeDriver
from drivers.rtde.motion import Control, ControlFactory, MotionProcess, obey
from drivers.rtde.protocol import Connect
from drivers.rtde.servo_program import ServoProgram
from sim_drivers.plant.plant import Plant
from sim_drivers.plant.sensors import Measurement
from sim_drivers.rtde.server import Ports, RtdeServer, Service

HOST = "arm"
NOWHERE = Ports(None, None, None, None)
"""A server that listens nowhere: it serves the sockets that it is given."""
SERVICES: dict[int, Service] = {30004: "rtde", 30003: "script", 29999: "dashboard", 30002: "secondary"}
PROGRAM = b"def rtde_control():\nend\n"
QUANTITIES = ("position", "velocity", "current", "target_position", "temperature")
PLAYING = 2
KILLED = -9


class Network:
    """The connections to a server; none works once `dead`."""

    def __init__(self, server: RtdeServer) -> None:
        self.dead = False
        self.asked: list[int] = []
        self._server = server

    def connect(self, host: str, port: int, timeout: float) -> socket.socket:
        self.asked.append(port)
        if self.dead or (port == 29999 and not self._server.version.has_dashboard):
            raise ConnectionRefusedError(111, "Connection refused")
        ours, theirs = socket.socketpair()
        self._server.serve(theirs, SERVICES[port])
        return ours


@contextlib.contextmanager
def serving(server: RtdeServer) -> Iterator[Network]:
    """Let a server run for the block; a server that breaks down is an error."""
    with server:
        yield Network(server)
    if server.failure is not None:
        raise server.failure


class RememberedArm:
    """An arm that keeps its measurements, one per period."""

    def __init__(self, arm: Plant) -> None:
        self.times: list[float] = []
        self._arm = arm
        self._measured: list[dict[str, FloatArray]] = []
        self.set_target, self.halt, self.advance = arm.set_target, arm.halt, arm.advance
        self.heat, self.block, self.stick = arm.heat, arm.block, arm.stick

    @property
    def time(self) -> float:
        return self._arm.time

    def measure(self) -> Measurement:
        measured = self._arm.measure()
        self.times.append(self._arm.time)
        self._measured.append({quantity: getattr(measured, quantity).copy() for quantity in QUANTITIES})
        return measured

    def values(self, quantity: str) -> FloatArray:
        """(N, n) in SI units and °C."""
        return np.array([measured[quantity] for measured in self._measured])


class PythonControl:
    """ur_rtde's control interface: commands to its program through registers, answers read back.

    A realtime command is sent and not waited for; another one waits until the program has done it.
    """

    def __init__(self, connect: Connect, clock: SimulatedClock, host: str, rate: float) -> None:
        self._clock = clock
        self._socket = connect(host, 30004, 1.0)
        self._socket.setblocking(False)
        self._splitter = wire.PackageSplitter()
        self._packages: deque[wire.Package] = deque()
        self._connected = True
        assert self._ask(wire.REQUEST_PROTOCOL_VERSION, struct.pack(">H", 2)) == b"\1"
        inputs = [*(f"input_int_register_{n}" for n in range(2)), *(f"input_double_register_{n}" for n in range(12))]
        answer = self._ask(wire.SETUP_INPUTS, ",".join(inputs).encode())
        if answer[0] == 0:
            raise RuntimeError("One of the RTDE input registers are already in use!")
        self._inputs = answer[0]
        self._write(0)  # a program before may have left its end there
        with connect(host, 30003, 1.0) as script:
            script.sendall(PROGRAM)
        outputs = [("output_int_register_0", "INT32"), ("runtime_state", "UINT32")]
        names = ",".join(name for name, _ in outputs).encode()
        answer = self._ask(wire.SETUP_OUTPUTS, struct.pack(">d", rate) + names)
        self._recipe = wire.Recipe(answer[0], tuple(outputs))
        self._signal, self._playing = 0, True
        assert self._ask(wire.START) == b"\1"
        self._wait_for(1)

    def servoJ(
        self, q: Sequence[float], speed: float, acceleration: float, time: float, lookahead: float, gain: float
    ) -> bool:
        return self._command(11, *q, speed, acceleration, time, lookahead, gain, wait=False)

    def setWatchdog(self, min_frequency: float) -> bool:
        return self._command(35, min_frequency)

    def kickWatchdog(self) -> bool:
        self._write(0)
        return self._connected

    def servoStop(self, a: float) -> bool:
        return self._command(16, a)

    def stopJ(self, a: float) -> None:
        self._command(34, a)

    def stopScript(self) -> None:
        self._command(255)

    def isConnected(self) -> bool:
        self._look(0.0)
        return self._connected

    def isProgramRunning(self) -> bool:
        self._look(0.0)
        return self._playing

    def disconnect(self) -> None:
        self._connected = False
        self._socket.close()

    def _command(self, number: int, *values: float, wait: bool = True) -> bool:
        if not self._wait_for(1):
            return False
        self._write(number, *values)
        if not wait:
            return True
        done = self._wait_for(2)
        if self._connected:
            self._write(0)
        return done

    def _write(self, number: int, *values: float) -> None:
        padded = (*values, *[0.0] * (12 - len(values)))
        self._send(wire.DATA_PACKAGE, struct.pack(">Bii12d", self._inputs, number, 0, *padded))

    def _wait_for(self, signal: int) -> bool:
        """Until the program confirms it; False where it does not run any more."""
        self._look(0.0)
        while self._connected and self._playing and self._signal != signal:
            self._look(60.0)
        return self._connected and self._playing

    def _look(self, seconds: float) -> None:
        """Process received data."""
        while self._connected and self._receive(seconds):
            seconds = 0.0
        while self._packages:
            package = self._packages.popleft()
            if package.kind == wire.DATA_PACKAGE:
                row = wire.decode_data(self._recipe, package.raw)[0]
                self._signal, self._playing = int(row["output_int_register_0"]), row["runtime_state"] == PLAYING

    def _receive(self, seconds: float) -> bool:
        if not self._clock.select([self._socket], [], seconds)[0]:
            return False
        try:
            chunk = self._socket.recv(65536)
        except OSError:
            chunk = b""
        self._connected = bool(chunk)
        self._packages += self._splitter.feed(chunk)
        return self._connected

    def _send(self, kind: int, payload: bytes = b"") -> None:
        try:
            self._socket.sendall(wire.encode_package(kind, payload))
        except OSError:
            self._connected = False

    def _ask(self, kind: int, payload: bytes = b"") -> bytes:
        self._send(kind, payload)
        while self._receive(60.0):
            while self._packages:
                if (package := self._packages.popleft()).kind == kind:
                    return package.payload
        raise RuntimeError("no answer")


TakesControl = Callable[[Connect, SimulatedClock, str, float], Control | ServoProgram]


def own_program(connect: Connect, clock: SimulatedClock, host: str, rate: float) -> ServoProgram:
    """Control by dynid's own program, as where ur_rtde has no wheel."""
    return ServoProgram(host, rate, connect, clock)


class PipeEnd:
    """One end of a pipe between threads of a simulated clock; has what is used of a `Connection`."""

    def __init__(self, clock: SimulatedClock) -> None:
        self.other: PipeEnd = self
        self.closed = False
        self._clock = clock
        self._inbox: deque[bytes] = deque()

    def poll(self, timeout: float = 0.0) -> bool:
        return self._clock.wait(lambda: self._inbox or self.closed or self.other.closed, timeout)

    def recv_bytes(self) -> bytes:
        self._clock.wait(lambda: self._inbox or self.closed or self.other.closed)
        if self.closed:
            raise OSError("handle is closed")
        if not self._inbox:
            raise EOFError
        return self._inbox.popleft()

    def send_bytes(self, buf: bytes) -> None:
        if self.closed or self.other.closed:
            raise BrokenPipeError(32, "Broken pipe")
        self.other._inbox.append(buf)

    def close(self) -> None:
        self.closed = True


def pipe(clock: SimulatedClock) -> tuple[PipeEnd, PipeEnd]:
    one, other = PipeEnd(clock), PipeEnd(clock)
    one.other, other.other = other, one
    return one, other


class MotionThread:
    """A motion process as a thread; `killed` is set, and its pipe broken, when it is killed."""

    def __init__(
        self, clock: SimulatedClock, factory: ControlFactory, host: str, rate: float, *, killed: Callable[[], object]
    ) -> None:
        self.pipe, self._far_end = pipe(clock)
        self.pid: int | None = None
        self.exitcode: int | None = None
        self._killed, self._clock = killed, clock
        self._thread = clock.thread(self._run, f"motion {host}", (factory, host, rate))
        self._thread.start()

    def is_alive(self) -> bool:
        return self._thread.is_alive()

    def join(self, timeout: float | None = None) -> None:
        self._thread.join(timeout)

    def kill(self) -> None:
        self.exitcode = KILLED
        self._far_end.close()
        self._killed()

    def _run(self, factory: ControlFactory, host: str, rate: float) -> None:
        try:
            end: Any = self._far_end
            status = 0 if obey(end, factory, host, rate, lambda: None, self._clock) else 1
        except SystemExit as left:
            status = int(str(left.code))
        self._far_end.close()
        self.exitcode = status if self.exitcode is None else self.exitcode


@contextlib.contextmanager
def opened(robot: Robot, connect: Connect, clock: SimulatedClock) -> Iterator[RtdeDriver]:
    """The driver of a controller, open; its motion process is a thread."""
    settings = replace(driver_settings(robot, {"host": HOST}), clock=clock)
    with recorded_session.opened(RtdeDriver(settings, connect, Motions(clock, connect).take_control)) as driver:
        yield driver


class Motions:
    """Makes `MotionProcess`es whose process is a thread; keeps what they opened, which ends with them.

    Args:
        clock: of all.
        connect: reaches the controller.
        control: takes control, given a connect, the clock, the host and the rate.
    """

    def __init__(self, clock: SimulatedClock, connect: Connect, control: TakesControl = PythonControl) -> None:
        self.made: list[MotionThread] = []
        self._control_of = control
        self._clock = clock
        self._connect = connect
        self._sockets: list[socket.socket] = []

    def take_control(self, host: str, rate: float, timeout: float) -> MotionProcess:
        start: Any = self._start  # a thread in place of a process
        return MotionProcess(host, rate, timeout, self._control, start)

    def kill(self) -> None:
        """Kill the motion process, as the operating system would."""
        self.made[-1].kill()

    def _start(self, factory: ControlFactory, host: str, rate: float, timeout: float) -> tuple[PipeEnd, MotionThread]:
        self.made.append(MotionThread(self._clock, factory, host, rate, killed=self._close))
        return self.made[-1].pipe, self.made[-1]

    def _control(self, host: str, rate: float) -> Control | ServoProgram:
        return self._control_of(self._open, self._clock, host, rate)

    def _open(self, host: str, port: int, timeout: float) -> socket.socket:
        self._sockets.append(self._connect(host, port, timeout))
        return self._sockets[-1]

    def _close(self) -> None:
        for one in self._sockets:
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()
