"""The controller's dashboard (port 29999), as far as it can end a program that nobody else can end any more."""

from __future__ import annotations

import socket
import time

PORT = 29999
ANSWER_LIMIT = 4096


def stop_program(host: str, timeout: float, port: int = PORT) -> bool:
    """Ask a controller to end its program; whether it says so within `timeout` [s]. Never raises.

    Controllers from software 10 on have no dashboard; others obey only in remote control.
    """
    deadline = time.monotonic() + timeout
    try:
        with socket.create_connection((host, port), timeout=timeout) as connection:
            _line(connection, deadline)  # the greeting
            connection.sendall(b"stop\n")
            return _line(connection, deadline).strip().lower() == b"stopped"
    except (OSError, UnicodeError):
        return False


def _line(connection: socket.socket, deadline: float) -> bytes:
    line = b""
    while not line.endswith(b"\n"):
        connection.settimeout(max(deadline - time.monotonic(), 1e-3))
        received = connection.recv(1)
        if not received or len(line) >= ANSWER_LIMIT or time.monotonic() > deadline:
            raise OSError("the dashboard does not answer")
        line += received
    return line
