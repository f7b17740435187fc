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
from collections.abc import Sequence
from types import FrameType

from drivers.errors import UsageError, WorkError
from sim_drivers.faults import parse_fault
from sim_drivers.rtde_server import RtdeServer

WIRES = ("rtde",)
REFRESH = 0.5
"""[s] between two live lines."""
CLEAR_LINE = "\r\x1b[K"


def simulate(robot: str, wire: str, host: str, version: str, seed: int, *, live: bool) -> None:
    """Serve a simulated arm until Ctrl-C or SIGTERM.

    Raises:
        UsageError: a wire, a version or an arm that cannot be simulated.
        RobotFileError: the robot file cannot be read, or has no truth.
        ConnectionFailedError: an address cannot be listened on.
    """
    from daq.robot import load_robot
    from sim_drivers.plant import Plant

    if wire not in WIRES:
        raise UsageError(f"'{wire}' cannot be simulated yet", hint=f"--wire {', '.join(WIRES)}")
    robot_file = load_robot(robot)
    server = RtdeServer(Plant(robot_file, seed=seed), host=host, version=version, joints=robot_file.robot.joints)
    serve(server, robot_file.robot.name, robot_file.robot.joint_names, live=live)


def serve(server: RtdeServer, name: str, joints: Sequence[str], *, live: bool) -> None:
    """Start a server, say so in one JSON object on standard output, and wait for Ctrl-C or SIGTERM.

    Raises:
        ConnectionFailedError: an address cannot be listened on.
        WorkError: the simulation broke down.
    """
    signal.signal(signal.SIGTERM, _interrupt)
    if hasattr(signal, "SIGTTIN"):
        # In the background reading the terminal must fail, not stop the process.
        signal.signal(signal.SIGTTIN, signal.SIG_IGN)
    shown = False
    with server:
        _warn_unless_loopback(server.host)
        # A full collection takes longer than a period.
        gc.collect()
        gc.freeze()
        ports = server.ports
        ready = {
            "ready": True,
            "robot": name,
            "host": server.host,
            "version": str(server.version),
            "rate_hz": server.rate,
            "rtde_port": ports.rtde,
            "dashboard_port": ports.dashboard if server.version.has_dashboard else None,
            "script_port": ports.script,
        }
        print(json.dumps(ready), flush=True)
        threading.Thread(target=_obey_typed_faults, args=(server, joints), name="faults", daemon=True).start()
        with contextlib.suppress(KeyboardInterrupt):
            while server.failure is None:
                time.sleep(REFRESH)
                while server.controller.messages:
                    _say(server.controller.messages.popleft(), live=shown)
                if live:
                    shown = True
                    print(f"{CLEAR_LINE}{_live_line(server)}", end="", file=sys.stderr, flush=True)
    if shown:
        print(file=sys.stderr)
    if server.failure is not None:
        raise WorkError(f"the simulation broke down: {server.failure!r}") from server.failure


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def _warn_unless_loopback(host: str) -> None:
    try:
        loopback = ipaddress.ip_address(host).is_loopback
    except ValueError:
        loopback = host == "localhost"
    if not loopback:
        print(f"dynid: {host} can be reached from the network; anybody there can move this arm", file=sys.stderr)


def _obey_typed_faults(server: RtdeServer, joints: Sequence[str]) -> None:
    try:
        for line in sys.stdin:
            if not line.strip():
                continue
            try:
                server.faults.request(parse_fault(line, joints))
            except UsageError as error:
                server.controller.messages.append(str(error))
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
