"""A controller's own joint limits and the arm's lengths, from its secondary interface (port 30002).

Neither RTDE nor the dashboard has them. The secondary interface sends ten packages of its state per second to each
client; one part of them, Configuration Data, has them (Universal Robots, "Client Interfaces": package 16, part 6; the
layout is that of Universal Robots' own client library).
"""

from __future__ import annotations

import socket
import struct
from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.errors import ConnectionFailedError
from drivers.rtde.protocol import Connect, connect_tcp

PORT = 30002
ROBOT_STATE, CONFIGURATION_DATA = 16, 6
HEADER = struct.Struct(">iB")
"""Header of a package, and of each of its parts: length with this header, type."""
CONTENT = struct.Struct(">24d5d24d")
"""Configuration Data: lowest and highest position, joint by joint; highest speed and acceleration, joint by joint;
default speeds and accelerations, size of the tool; a, d, alpha and theta (Denavit-Hartenberg) of all joints."""
LARGEST_PACKAGE = 65536
LONGEST_LINK = 10.0
"""[m]: no arm has longer ones."""


@dataclass(frozen=True)
class Configuration:
    """What a controller tells of its arm."""

    # (4, 6) lowest and highest position [rad], speed [rad/s] and acceleration [rad/s²] of the joints
    limits: FloatArray
    lengths: FloatArray | None  # (4,) upper arm, forearm, shoulder offset, wrist offset [m]; None where it tells none


def read_configuration(
    host: str, timeout: float, connect: Connect = connect_tcp, clock: Clock = SYSTEM_CLOCK
) -> Configuration:
    """Ask a controller.

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
                    configuration = _configuration_in(package) if kind == ROBOT_STATE else None
                    if configuration is not None:
                        return configuration
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ConnectionFailedError(
            f"no joint limits from the secondary interface: {reason}", where=f"{host}:{PORT}"
        ) from error


def _received(connection: socket.socket, pending: bytes, deadline: float, clock: Clock) -> bytes:
    readable, _ = clock.select([connection], [], max(0.0, deadline - clock.now()))
    if not readable:
        raise OSError("it sent none in time")
    chunk = connection.recv(LARGEST_PACKAGE)
    if not chunk:
        raise OSError("it closed the connection")
    return pending + chunk


def _configuration_in(package: bytes) -> Configuration | None:
    """The configuration in a package of the robot's state; None where it has none that makes sense."""
    at = HEADER.size
    while at + HEADER.size <= len(package):
        length, kind = HEADER.unpack_from(package, at)
        if length < HEADER.size:
            return None
        if kind == CONFIGURATION_DATA and HEADER.size + CONTENT.size <= length <= len(package) - at:
            values = np.array(CONTENT.unpack_from(package, at + HEADER.size))
            limits = np.concatenate([values[:12].reshape(6, 2).T, values[12:24].reshape(6, 2).T])
            sensible = np.isfinite(limits).all() and (limits[0] < limits[1]).all() and (limits[2:] > 0.0).all()
            a, d = values[29:41].reshape(2, 6)
            lengths = np.abs([a[1], a[2], d[1] + d[2] + d[3], d[4]])
            sound = bool(np.isfinite(lengths).all() and (lengths < LONGEST_LINK).all() and (lengths[:2] > 0.0).all())
            return Configuration(limits, lengths if sound else None) if sensible else None
        at += length
    return None
