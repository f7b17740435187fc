"""A lock on an arm: of all programs on this computer, one at a time moves it."""

from __future__ import annotations

import ipaddress
import os
import socket
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager

from daq.robot.schema import Robot
from daq.session.connections import connection_keys, connection_names
from drivers.core.errors import MotionRefusedError
from drivers.core.files import held_lock
from drivers.declaration import declared

_WITHIN_A_PROCESS = "virtual"
"""python-can's interface that no other program can reach."""
_THIS_COMPUTER = ("127.0.0.1", "::1", "0.0.0.0", "::")
"""Addresses of one arm; simulated ones have 127.0.0.2 and so on."""


@contextmanager
def only_mover(robot: Robot, wire: str | None = None, host: str | None = None) -> Iterator[None]:
    """Hold the lock on the arm at the end of a connection; the system releases it when this program dies.

    However its place is spelled: a host, the connection's own where none is given, is locked by each of its addresses,
    a serial port by its file. A connection that does not say where its arm is, and computers without `flock`, have no
    lock. The connection is the first one where `wire` is None.

    Raises:
        MotionRefusedError: another program holds it.
        UsageError: no such connection.
    """
    name = connection_names(robot, wire)[0]
    keys = connection_keys(robot, name)
    if host is not None:
        keys["host"] = host
    places = _places(keys, robot.connections[name].driver)
    with ExitStack() as held:
        for place in places:
            if not held.enter_context(held_lock(place)):
                raise MotionRefusedError(
                    "another program on this computer is moving this arm", where=place, hint="wait until it has ended"
                )
        yield


def _places(keys: Mapping[str, object], driver: str) -> list[str]:
    """Addresses of an arm by its connection's keys, in one spelling; several for a host with several addresses."""
    if (host := keys.get("host")) is not None and "/" in str(host):  # a serial port
        return [os.path.realpath(str(host))]
    if host is not None:
        port = keys.get("port") or declared(driver).port
        return [f"{address}, port {port}" for address in sorted(_addresses(str(host)))]
    if (channel := keys.get("channel")) is not None and keys.get("interface") != _WITHIN_A_PROCESS:
        return [f"{keys.get('interface')} {_bus(str(channel))}"]
    if (url := keys.get("url")) is None:
        return []
    return [os.path.realpath(str(url)) if os.path.isabs(str(url)) else str(url)]


def _addresses(host: str) -> set[str]:
    """A host's addresses; its name where it has none, `localhost` for this computer's usual two."""
    name = host.strip().rstrip(".").casefold()
    try:
        numbers = {str(entry[4][0]) for entry in socket.getaddrinfo(name, None, type=socket.SOCK_STREAM)}
    except (OSError, ValueError):  # not known, or no name at all: opening the connection says so
        return {name}
    addresses = {ipaddress.ip_address(address) for address in numbers}
    plain = {getattr(address, "ipv4_mapped", None) or address for address in addresses}
    return {"localhost" if str(address) in _THIS_COMPUTER else str(address) for address in plain}


def _bus(channel: str) -> str:
    name = channel.strip().partition("@")[0]  # python-can's rate of a serial port follows
    if "/" in name:
        return os.path.realpath(name)
    try:
        return str(ipaddress.ip_address(name))
    except ValueError:
        return name
