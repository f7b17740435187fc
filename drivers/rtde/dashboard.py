"""The controller's dashboard (port 29999), as far as it can end a program that ended its connection."""

from __future__ import annotations

import socket

from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.rtde.connect import Connect, connect_tcp

PORT = 29999
ANSWER_LIMIT = 4096


def stop_program(host: str, timeout: float, connect: Connect = connect_tcp, clock: Clock = SYSTEM_CLOCK) -> bool:
    """Ask a controller to end its program; whether it says so within `timeout` [s]. Never raises.

    Controllers from software 10 on have no dashboard; others obey only in remote control.

    Args:
        host: name or address of the controller.
        timeout: [s].
        connect: reaches the controller.
        clock: the host's.
    """
    deadline = clock.now() + timeout
    try:
        with connect(host, PORT, timeout) as connection:
            connection.setblocking(False)
            _line(connection, deadline, clock)  # the greeting
            connection.sendall(b"stop\n")
            return _line(connection, deadline, clock).strip().lower() == b"stopped"
    except (OSError, UnicodeError):
        return False


def _line(connection: socket.socket, deadline: float, clock: Clock) -> bytes:
    line = b""
    while not line.endswith(b"\n"):
        readable, _ = clock.select([connection], [], deadline - clock.now())
        received = connection.recv(1) if readable else b""
        if not received or len(line) >= ANSWER_LIMIT:
            raise OSError("the dashboard does not answer")
        line += received
    return line
