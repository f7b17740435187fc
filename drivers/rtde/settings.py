"""The keys of an RTDE connection in a robot file."""

from __future__ import annotations

from collections.abc import Mapping

from pydantic import Field

from drivers.connection_settings import ConnectionSettings, Text, read_settings
from drivers.rtde import protocol as wire


class RtdeSettings(ConnectionSettings):
    """How to reach a Universal Robots controller."""

    host: Text = Field(description="the controller's name or address, such as 192.168.56.101")
    port: int = Field(wire.PORT, ge=1, le=65535, description=f"of RTDE, usually {wire.PORT}")
    rate: float | None = Field(
        None, ge=1, le=500, description="[Hz] of the samples, usually 500 or 125; default: the controller's maximum"
    )
    serial: Text | None = Field(None, description="the serial number that the controller must have; default: any")
    timeout: float = Field(5.0, ge=0.1, le=300, description="[s] for connecting, and for taking control of the arm")


def parse_settings(connection: Mapping[str, object]) -> RtdeSettings:
    """Check a connection's keys.

    Raises:
        UsageError: names every key that is wrong, what was found and what is allowed.
    """
    return read_settings(RtdeSettings, connection, "RTDE")
