"""The keys of a serial thermometer's connection in a robot file."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

from drivers.connection_keys import ConnectionKeys
from drivers.errors import UsageError

UNITS = ("degC", "degF", "K")
RANGE = (-60.0, 250.0)
"""Temperatures [°C] that a joint can have; outside, a digital sensor reports its own trouble (-127, 999)."""
OPEN_PERIODS = 3.0
"""How many periods an opening waits for a first temperature where no `timeout` is given."""
LEAST_TIMEOUT = 5.0
"""[s]; some adapters restart their board when the port is opened, which takes seconds."""
_KEYS = ConnectionKeys("the serial thermometer")


@dataclass(frozen=True)
class ThermometerSettings:
    """How to reach a thermometer and how to read its lines.

    Attributes:
        url: device, or any URL that pyserial knows (loop://, socket://host:port, rfc2217://…).
        pattern: regular expression with the named groups `channel` and `value`; every match in a line is a value.
        channels: what the group `channel` says → joint.
        rate: how often each channel comes [Hz].
        baudrate: [bit/s].
        unit: of the values: degC, degF or K.
        range: lowest and highest temperature [°C] that is believed.
        required: whether its loss stops the session.
        timeout: for the first temperature after opening [s].
    """

    url: str
    pattern: re.Pattern[str]
    channels: Mapping[str, str]
    rate: float
    baudrate: int = 9600
    unit: str = "degC"
    range: tuple[float, float] = RANGE
    required: bool = False
    timeout: float = LEAST_TIMEOUT


def parse_settings(connection: Mapping[str, object], joints: Sequence[str]) -> ThermometerSettings:
    """Check a connection's keys.

    Raises:
        UsageError: names the key, what was found and what is allowed.
    """
    known = [field.name for field in fields(ThermometerSettings)]
    for key in connection:
        if key not in known:
            raise UsageError(f"a serial thermometer has no key '{key}'", hint=f"allowed: {', '.join(known)}")
    url = connection.get("url")
    if not isinstance(url, str) or not url.strip():
        raise _KEYS.wrong(
            "url", url, "a device such as /dev/ttyUSB0 or COM3, or a pyserial URL such as socket://host:port"
        )
    rate = _KEYS.number("rate", connection.get("rate"), 1e-3, 1e4, "how often each channel comes, 0.001 to 10000 Hz")
    allowed_baudrate = "a whole number from 50 to 4000000 bit/s, such as 9600 or 115200"
    baudrate = _KEYS.whole("baudrate", connection.get("baudrate", 9600), 50, 4_000_000, allowed_baudrate)
    unit = connection.get("unit", "degC")
    if unit not in UNITS:
        raise _KEYS.wrong("unit", unit, ", ".join(UNITS))
    required = connection.get("required", False)
    if not isinstance(required, bool):
        raise _KEYS.wrong("required", required, "true or false")
    timeout = _KEYS.number(
        "timeout",
        connection.get("timeout", max(LEAST_TIMEOUT, OPEN_PERIODS / rate)),
        0.1,
        1e4,
        "a number from 0.1 to 10000 s",
    )
    return ThermometerSettings(
        url.strip(),
        _pattern(connection.get("pattern")),
        _channels(connection.get("channels"), joints),
        rate,
        baudrate,
        str(unit),
        _range(connection.get("range", list(RANGE))),
        required,
        timeout,
    )


def _pattern(text: object) -> re.Pattern[str]:
    allowed = r"a regular expression such as 'T(?P<channel>\d+)=(?P<value>[-+.\d]+)'"
    if not isinstance(text, str) or not text:
        raise _KEYS.wrong("pattern", text, allowed)
    try:
        pattern = re.compile(text)
    except (re.error, RecursionError, OverflowError) as error:
        raise UsageError(f"key 'pattern' is not a regular expression: {error}", hint=f"allowed: {allowed}") from error
    missing = [group for group in ("channel", "value") if group not in pattern.groupindex]
    if missing:
        raise UsageError(f"key 'pattern' lacks the named group(s) {', '.join(missing)}", hint=f"allowed: {allowed}")
    return pattern


def _channels(mapping: object, joints: Sequence[str]) -> dict[str, str]:
    if not isinstance(mapping, Mapping) or not mapping:
        raise _KEYS.wrong("channels", mapping, f"a mapping channel → joint, such as {{1: {joints[0]}}}")
    found: dict[str, str] = {}
    for channel, joint in mapping.items():
        if isinstance(channel, bool) or not isinstance(channel, (str, int)):
            raise UsageError(f"'channels' has the channel {channel!r}", hint="a whole number or a text")
        if not isinstance(joint, str) or joint not in joints:
            raise UsageError(
                f"'channels' gives channel {channel} to {joint!r}, which is no joint",
                hint=f"joints: {', '.join(joints)}",
            )
        if joint in found.values():
            raise UsageError(f"'channels' gives joint '{joint}' two channels", hint="one channel a joint")
        if str(channel) in found:
            raise UsageError(f"'channels' names channel {channel} twice", hint="one joint a channel")
        found[str(channel)] = joint
    return found


def _range(limits: object) -> tuple[float, float]:
    allowed = "[lowest, highest] in °C, in rising order, from -273.15 to 3000"
    if not isinstance(limits, Sequence) or isinstance(limits, str) or len(limits) != 2:
        raise _KEYS.wrong("range", limits, allowed)
    low, high = (_KEYS.number("range", value, -273.15, 3000.0, allowed) for value in limits)
    if low >= high:
        raise _KEYS.wrong("range", list(limits), allowed)
    return low, high
