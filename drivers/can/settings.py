"""The keys that every connection over CAN has."""

from __future__ import annotations

from pydantic import Field

from drivers.connection_settings import ConnectionSettings, Text


class CanSettings(ConnectionSettings):
    """A CAN bus, see `drivers.can.bus.open_bus`."""

    interface: Text = Field(description="a python-can interface: socketcan, slcan, pcan, udp_multicast, virtual, …")
    channel: Text | int = Field(description="what the interface calls a bus: can0, /dev/ttyACM0, 239.74.163.2, …")
    bitrate: int = Field(1_000_000, ge=1000, le=1_000_000, description="[bit/s]")
    options: dict[str, object] = Field(
        default_factory=dict, max_length=100, description="a mapping of further python-can arguments of the interface"
    )
