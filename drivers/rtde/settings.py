"""The keys of an RTDE connection in a robot file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

from drivers.connection_keys import ConnectionKeys
from drivers.errors import UsageError
from drivers.rtde import protocol as wire

_KEYS = ConnectionKeys("the RTDE connection")


@dataclass(frozen=True)
class RtdeSettings:
    """How to reach a Universal Robots controller.

    Attributes:
        host: name or address.
        port: of RTDE.
        rate: of the samples [Hz]; None for the controller's maximum (500, or 125 on CB3).
        timeout: for connecting, and for taking control of the arm [s].
    """

    host: str
    port: int = wire.PORT
    rate: float | None = None
    timeout: float = 5.0


def parse_settings(connection: Mapping[str, object]) -> RtdeSettings:
    """Check a connection's keys.

    Raises:
        UsageError: names the key, what was found and what is allowed.
    """
    known = [field.name for field in fields(RtdeSettings)]
    for key in connection:
        if key not in known:
            raise UsageError(f"an RTDE connection has no key '{key}'", hint=f"allowed: {', '.join(known)}")
    host = connection.get("host")
    if not isinstance(host, str) or not host.strip():
        raise _KEYS.wrong("host", host, "the controller's name or address, such as 192.168.56.101")
    allowed_port = f"a whole number from 1 to 65535, usually {wire.PORT}"
    port = _KEYS.whole("port", connection.get("port", wire.PORT), 1, 65535, allowed_port)
    rate = connection.get("rate")
    if rate is not None:
        rate = _KEYS.number(
            "rate", rate, 1.0, 500.0, "a number from 1 to 500 Hz, usually 500 or 125; left out, the maximum"
        )
    timeout = _KEYS.number("timeout", connection.get("timeout", 5.0), 0.1, 300.0, "a number from 0.1 to 300 s")
    return RtdeSettings(host.strip(), port, rate, timeout)
