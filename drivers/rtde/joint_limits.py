"""A controller's own joint limits, from its secondary interface (port 30002).

Neither RTDE nor the dashboard tells them. The secondary interface sends ten packages of its state per second to whoever
connects; one part of each, Configuration Data, has the limits (Universal Robots, "Client Interfaces": package 16, part
6; the layout is that of Universal Robots' own client library).
"""

from __future__ import annotations

import socket
import struct

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.errors import ConnectionFailedError
from drivers.rtde.connect import Connect, connect_tcp

PORT = 30002
ROBOT_STATE, CONFIGURATION_DATA = 16, 6
HEADER = struct.Struct(">iB")
"""Of a package, and of each of its parts: length with this header, type."""
LIMITS = struct.Struct(">24d")
"""Begin of Configuration Data: lowest and highest position, joint by joint; then highest speed and acceleration."""
LARGEST_PACKAGE = 65536


def read_joint_limits(
    host: str, timeout: float, connect: Connect = connect_tcp, clock: Clock = SYSTEM_CLOCK
) -> FloatArray:
    """Lowest and highest position [rad], speed [rad/s] and acceleration [rad/s²] of the joints: (4, 6).

    Raises:
        ConnectionFailedError: none within `timeout` [s]; says why.
    """
    deadline = clock.now() + timeout
    pending = b""
    try:
        with connect(host, PORT, timeout) as connection:
            connection.setblocking(False)
            while True:
                pending = _received(connection, pending, deadline, clock)
                while len(pending) >= HEADER.size:
                    length, kind = HEADER.unpack_from(pending)
                    if not HEADER.size <= length <= LARGEST_PACKAGE:
                        raise OSError(f"a package of {length} bytes is none of its protocol")
                    if len(pending) < length:
                        break
                    package, pending = pending[:length], pending[length:]
                    limits = _limits_in(package) if kind == ROBOT_STATE else None
                    if limits is not None:
                        return limits
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ConnectionFailedError(
            f"no joint limits from the secondary interface: {reason}", where=f"{host}:{PORT}"
        ) from error


def _received(connection: socket.socket, pending: bytes, deadline: float, clock: Clock) -> bytes:
    readable, _ = clock.select([connection], [], max(0.0, deadline - clock.now()))
    if not readable:
        raise OSError("it sends none in time")
    chunk = connection.recv(LARGEST_PACKAGE)
    if not chunk:
        raise OSError("it closed the connection")
    return pending + chunk


def _limits_in(package: bytes) -> FloatArray | None:
    """The limits of a package of the robot's state; None where it has none that make sense."""
    at = HEADER.size
    while at + HEADER.size <= len(package):
        length, kind = HEADER.unpack_from(package, at)
        if length < HEADER.size:
            return None
        if kind == CONFIGURATION_DATA and HEADER.size + LIMITS.size <= length <= len(package) - at:
            values = np.array(LIMITS.unpack_from(package, at + HEADER.size))
            limits = np.concatenate([values[:12].reshape(6, 2).T, values[12:].reshape(6, 2).T])
            sensible = np.isfinite(limits).all() and (limits[0] < limits[1]).all() and (limits[2:] > 0.0).all()
            return limits if sensible else None
        at += length
    return None
