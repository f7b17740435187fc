"""The controller's dashboard (port 29999): ends a program that ended its connection, and tells the serial number."""

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
    return _asked(b"stop", host, timeout, connect, clock).lower() == "stopped"


def serial_number(host: str, timeout: float, connect: Connect = connect_tcp, clock: Clock = SYSTEM_CLOCK) -> str:
    """A controller's serial number, as `stop_program` is asked; empty where it tells none. Never raises."""
    answer = _asked(b"get serial number", host, timeout, connect, clock)
    return answer if answer.isprintable() and " " not in answer else ""  # else it does not know the question


def _asked(question: bytes, host: str, timeout: float, connect: Connect, clock: Clock) -> str:
    deadline = clock.now() + timeout
    try:
        with connect(host, PORT, timeout) as connection:
            connection.setblocking(False)
            _line(connection, deadline, clock)  # the greeting
            connection.sendall(question + b"\n")
            return _line(connection, deadline, clock).strip().decode("ascii")
    except (OSError, UnicodeError):
        return ""


def _line(connection: socket.socket, deadline: float, clock: Clock) -> bytes:
    line = b""
    while not line.endswith(b"\n"):
        readable, _ = clock.select([connection], [], deadline - clock.now())
        received = connection.recv(1) if readable else b""
        if not received or len(line) >= ANSWER_LIMIT:
            raise OSError("the dashboard does not answer")
        line += received
    return line
