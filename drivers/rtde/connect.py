"""How a controller is reached: over TCP, or over whatever sockets a caller joins to one."""

from __future__ import annotations

import socket
from collections.abc import Callable

RECEIVE_BUFFER_BYTES = 4 << 20

Connect = Callable[[str, int, float], socket.socket]
"""Connects to a port of a host within so many seconds, or raises OSError."""


def connect_tcp(host: str, port: int, timeout: float) -> socket.socket:
    """A TCP connection that sends at once and holds seconds of samples for a reader that is late.

    Raises:
        OSError: no answer within `timeout` [s].
        UnicodeError: the host is no name.
    """
    connection = socket.create_connection((host, port), timeout=timeout)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
    return connection
