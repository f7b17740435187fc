"""`dynid sim --wire rtde`: a simulated UR controller."""

from __future__ import annotations

import ipaddress
import sys
from collections.abc import Sequence
from typing import Self

from sim_drivers.faults import parse_fault
from sim_drivers.rtde.server import RtdeServer


class ServedRtde:
    """An RTDE server that is served until it is interrupted."""

    def __init__(self, server: RtdeServer, joints: Sequence[str]) -> None:
        self._server, self._joints = server, joints
        self.messages = server.controller.messages

    @property
    def failure(self) -> BaseException | None:
        """What ended it; None while all is well."""
        return self._server.failure

    def __enter__(self) -> Self:
        self._server.start()
        _warn_unless_loopback(self._server.host)
        return self

    def __exit__(self, *_: object) -> None:
        self._server.stop()

    def ready(self) -> dict[str, object]:
        """What a client must know to reach it."""
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
        """How it goes, in one line."""
        return _live_line(self._server)

    def obey(self, line: str) -> None:
        """Cause a fault as a person types it.

        Raises:
            UsageError: not a fault.
        """
        self._server.cause(parse_fault(line, "UR controller", self._joints))


def _warn_unless_loopback(host: str) -> None:
    try:
        loopback = ipaddress.ip_address(host).is_loopback
    except ValueError:
        loopback = host == "localhost"
    if not loopback:
        print(f"dynid: {host} can be reached from the network; anybody there can move this arm", file=sys.stderr)


def _live_line(server: RtdeServer) -> str:
    status = server.status()
    state = "protective stop" if status.safety_mode != 1 else "program running" if status.playing else "idle"
    line = f"{server.host} {status.time:8.1f} s  {state}, {status.rtde_clients} clients, {status.packages} packages"
    troubles = {"withheld": status.faulted, "overflowed": status.overflowed, "stalls": status.stalls}
    return line + "".join(f", {count} {word}" for word, count in troubles.items() if count)
