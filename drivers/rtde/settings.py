"""The keys of an RTDE connection in a robot file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields

from drivers.errors import UsageError
from drivers.rtde import wire


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
        raise _wrong("host", host, "the controller's name or address, such as 192.168.56.101")
    port = connection.get("port", wire.PORT)
    if not isinstance(port, int) or isinstance(port, bool) or not 1 <= port <= 65535:
        raise _wrong("port", port, f"a whole number from 1 to 65535, usually {wire.PORT}")
    rate = connection.get("rate")
    if rate is not None:
        rate = _number("rate", rate, 1.0, 500.0, "a number from 1 to 500 Hz, usually 500 or 125; left out, the maximum")
    timeout = _number("timeout", connection.get("timeout", 5.0), 0.1, 300.0, "a number from 0.1 to 300 s")
    return RtdeSettings(host.strip(), port, rate, timeout)


def _number(key: str, value: object, low: float, high: float, allowed: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise _wrong(key, value, allowed)
    if not low <= value <= high:
        raise _wrong(key, value, allowed)
    return float(value)


def _wrong(key: str, value: object, allowed: str) -> UsageError:
    found = "is missing" if value is None else f"is {value!r}"
    return UsageError(f"key '{key}' of the RTDE connection {found}", hint=f"allowed: {allowed}")
