"""What `dynid sim` does: build the plant, serve it, obey the faults that are typed, until it is interrupted."""

from __future__ import annotations

import contextlib
import gc
import ipaddress
import json
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import FrameType
from typing import TYPE_CHECKING, Protocol, Self

from drivers.errors import DynidError, UsageError, WorkError
from sim_drivers.faults import parse_fault
from sim_drivers.rtde_server import RtdeServer

if TYPE_CHECKING:
    from daq.robot import RobotFile

WIRES = ("rtde", "canopen", "slcan", "can", "thermometer")
REFRESH = 0.5
"""[s] between two live lines."""
CLEAR_LINE = "\r\x1b[K"


class Served(Protocol):
    """A simulated device, whatever its wire; entering its context starts it, leaving stops it.

    Attributes:
        messages: for the terminal, oldest first.
        failure: what ended it; None while all is well.
    """

    messages: deque[str]

    @property
    def failure(self) -> BaseException | None: ...  # noqa: D102

    def __enter__(self) -> Self: ...

    def __exit__(self, *_: object) -> None: ...

    def ready(self) -> Mapping[str, object]:
        """What a client must know to reach it; known once started."""

    def live_line(self) -> str:
        """How it goes, in one line."""

    def obey(self, line: str) -> None:
        """Cause a fault as a person types it.

        Raises:
            UsageError: not a fault.
        """


@dataclass(frozen=True)
class BusOptions:
    """How a simulated arm's wire differs from its robot file's, and what is served beside it.

    Attributes:
        interface, channel: of python-can; the connection's where None.
        swap: two joints whose drives have each other's node id, "joint,joint"; None for none.
        worst_stuffing: whether every frame is as long as it can be.
        thermometer: whether the robot file's serial thermometer is served beside it.
    """

    interface: str | None = None
    channel: str | None = None
    swap: str | None = None
    worst_stuffing: bool = False
    thermometer: bool = False


def simulate(
    robot: str, wire: str, host: str, version: str, seed: int, *, live: bool, bus: BusOptions = BusOptions()
) -> None:
    """Serve a simulated arm until Ctrl-C or SIGTERM.

    Raises:
        UsageError: a wire, a version or an arm that cannot be simulated, or a connection whose keys are wrong.
        RobotFileError: the robot file cannot be read, or has no truth.
        ConnectionFailedError: an address cannot be listened on, or a bus not opened.
    """
    from daq.robot import load_robot

    if wire not in WIRES:
        raise UsageError(f"'{wire}' cannot be simulated yet", hint=f"--wire {', '.join(WIRES)}")
    robot_file = load_robot(robot)
    served = _served(robot_file, wire, host, version, seed, bus)
    serve_until_interrupted(served, robot_file.robot.name, live=live)


def _served(robot_file: RobotFile, wire: str, host: str, version: str, seed: int, bus: BusOptions) -> Served:
    from sim_drivers.plant import Plant

    if wire == "thermometer":
        from sim_drivers.thermometer_wire import thermometer_alone

        return thermometer_alone(robot_file, seed)
    plant = Plant(robot_file, seed=seed)
    served: Served
    if wire == "rtde":
        server = RtdeServer(plant, host=host, version=version, joints=robot_file.robot.joints)
        served = _ServedRtde(server, robot_file.robot.joint_names)
    else:
        from sim_drivers import can_wires

        prepare = {"canopen": can_wires.canopen, "slcan": can_wires.slcan, "can": can_wires.proprietary}[wire]
        served = prepare(robot_file, plant, bus)
    if bus.thermometer:
        from sim_drivers.thermometer import serve_thermometer
        from sim_drivers.thermometer_wire import BesideThermometer, thermometer_keys

        served = BesideThermometer(served, serve_thermometer(plant, thermometer_keys(robot_file.robot), seed))
    return served


def serve_until_interrupted(served: Served, name: str, *, live: bool) -> None:
    """Start a simulated device, say so in one JSON object on standard output, and wait for Ctrl-C or SIGTERM.

    Raises:
        ConnectionFailedError: its wire cannot be had.
        WorkError: the simulation broke down.
    """
    signal.signal(signal.SIGTERM, _interrupt)
    if hasattr(signal, "SIGTTIN"):
        # In the background reading the terminal must fail, not stop the process.
        signal.signal(signal.SIGTTIN, signal.SIG_IGN)
    shown = False
    with served:
        # A full collection takes longer than a period.
        gc.collect()
        gc.freeze()
        print(json.dumps({"ready": True, "robot": name, **served.ready()}), flush=True)
        # A person types and looks at this: the terminal's time is nobody else's.
        threading.Thread(target=_obey_typed_faults, args=(served,), name="faults", daemon=True).start()
        with contextlib.suppress(KeyboardInterrupt):
            while served.failure is None:
                time.sleep(REFRESH)
                while served.messages:
                    _say(served.messages.popleft(), live=shown)
                if live:
                    shown = True
                    print(f"{CLEAR_LINE}{served.live_line()}", end="", file=sys.stderr, flush=True)
    if shown:
        print(file=sys.stderr)
    if isinstance(served.failure, DynidError):
        raise served.failure
    if served.failure is not None:
        raise WorkError(f"the simulation broke down: {served.failure!r}") from served.failure


class _ServedRtde:
    """An RTDE server as `serve_until_interrupted` wants it."""

    def __init__(self, server: RtdeServer, joints: Sequence[str]) -> None:
        self._server, self._joints = server, joints
        self.messages = server.controller.messages

    @property
    def failure(self) -> BaseException | None:
        return self._server.failure

    def __enter__(self) -> Self:
        self._server.start()
        _warn_unless_loopback(self._server.host)
        return self

    def __exit__(self, *_: object) -> None:
        self._server.stop()

    def ready(self) -> dict[str, object]:
        server, ports = self._server, self._server.ports
        return {
            "host": server.host,
            "version": str(server.version),
            "rate_hz": server.rate,
            "rtde_port": ports.rtde,
            "dashboard_port": ports.dashboard if server.version.has_dashboard else None,
            "script_port": ports.script,
        }

    def live_line(self) -> str:
        return _live_line(self._server)

    def obey(self, line: str) -> None:
        self._server.faults.request(parse_fault(line, self._joints))


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def _warn_unless_loopback(host: str) -> None:
    try:
        loopback = ipaddress.ip_address(host).is_loopback
    except ValueError:
        loopback = host == "localhost"
    if not loopback:
        print(f"dynid: {host} can be reached from the network; anybody there can move this arm", file=sys.stderr)


def _obey_typed_faults(served: Served) -> None:
    try:
        for line in sys.stdin:
            if not line.strip():
                continue
            try:
                served.obey(line)
            except UsageError as error:
                served.messages.append(str(error))
    except (OSError, ValueError, AttributeError):
        return  # no standard input, or not ours to read


def _say(message: str, *, live: bool) -> None:
    print(f"{CLEAR_LINE if live else ''}dynid: {message}", file=sys.stderr, flush=True)


def _live_line(server: RtdeServer) -> str:
    status = server.status()
    state = "protective stop" if status.safety_mode != 1 else "program running" if status.playing else "idle"
    line = f"{server.host} {status.time:8.1f} s  {state}, {status.rtde_clients} clients, {status.packages} packages"
    troubles = {"withheld": status.faulted, "overflowed": status.overflowed, "stalls": status.stalls}
    return line + "".join(f", {count} {word}" for word, count in troubles.items() if count)
