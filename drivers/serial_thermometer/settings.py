"""The keys of a serial thermometer's connection in a robot file."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, Strict, ValidationInfo, field_validator, model_validator

from drivers.connection_settings import ConnectionSettings, Text, read_settings, refused

OPEN_PERIODS = 3.0
"""How many periods an opening waits for a first temperature where no `timeout` is given."""
LEAST_TIMEOUT = 5.0
"""[s]; some adapters restart their board when the port is opened, which takes seconds."""
COLDEST, HOTTEST = -273.15, 3000.0


def _compiled(text: object) -> object:
    if not isinstance(text, str):
        return text
    try:
        pattern = re.compile(text)
    except (re.error, RecursionError, OverflowError) as error:
        raise refused(f"{text!r} is not a regular expression: {error}") from error
    missing = [group for group in ("channel", "value") if group not in pattern.groupindex]
    if missing:
        raise refused(f"{text!r} lacks named groups: {', '.join(missing)}")
    return pattern


class ThermometerSettings(ConnectionSettings):
    """How to reach a thermometer and how to read its lines."""

    url: Text = Field(description="a device such as /dev/ttyUSB0 or COM3, or a pyserial URL such as socket://host:port")
    pattern: Annotated[re.Pattern[str], BeforeValidator(_compiled)] = Field(
        description=r"a regular expression such as 'T(?P<channel>\d+)=(?P<value>[-+.\d]+)'; every match is a value"
    )
    channels: dict[str, str] = Field(
        description="a mapping of what the group 'channel' matches → joint, such as {1: j1}"
    )
    rate: float = Field(ge=1e-3, le=1e4, description="[Hz] of each channel")
    baudrate: int = Field(9600, ge=50, le=4_000_000, description="[bit/s], such as 9600 or 115200")
    unit: Literal["degC", "degF", "K"] = Field("degC", description="the unit of the values")
    range: Annotated[tuple[float, float], Strict(strict=False)] = Field(
        # Outside, a digital sensor reports its own trouble (-127, 999).
        (-60.0, 250.0),
        description=f"[lowest, highest] in °C that is accepted, in increasing order, from {COLDEST:g} to {HOTTEST:g}",
    )
    required: bool = Field(False, description="whether losing it stops the session")
    timeout: float = Field(
        0.0,
        ge=0.1,
        le=1e4,
        description=f"[s] for the first temperature after opening; left out, {OPEN_PERIODS:g} periods, "
        f"at least {LEAST_TIMEOUT:g} s",
    )

    @field_validator("channels", mode="before")
    @classmethod
    def _joint_per_channel(cls, channels: object, info: ValidationInfo) -> object:
        joints: Sequence[str] = (info.context or {})["joints"]
        if not isinstance(channels, dict):
            return channels
        named: dict[str, str] = {}
        for channel, joint in channels.items():
            if isinstance(channel, bool) or not isinstance(channel, str | int):
                raise refused(f"channel {channel!r} is neither an integer nor a text")
            if not isinstance(joint, str) or joint not in joints:
                raise refused(
                    f"channel {channel} is given to {joint!r}, which is not a joint", f"joints: {', '.join(joints)}"
                )
            if joint in named.values():
                raise refused(f"joint '{joint}' has two channels", "one channel per joint")
            if str(channel) in named:
                raise refused(f"channel {channel} is named twice", "one joint per channel")
            named[str(channel)] = joint
        if not named:
            raise refused("no channel")
        return named

    @field_validator("range")
    @classmethod
    def _rising(cls, limits: tuple[float, float]) -> tuple[float, float]:
        if not COLDEST <= limits[0] < limits[1] <= HOTTEST:
            raise refused(f"not {list(limits)}")
        return limits

    @model_validator(mode="after")
    def _patience(self) -> Self:
        patience = self.timeout or max(LEAST_TIMEOUT, OPEN_PERIODS / self.rate)
        return self.model_copy(update={"timeout": patience})


def parse_settings(connection: Mapping[str, object], joints: Sequence[str]) -> ThermometerSettings:
    """Check a connection's keys.

    Raises:
        UsageError: names every key that is wrong, what was found and what is allowed.
    """
    return read_settings(ThermometerSettings, connection, "serial_thermometer", {"joints": joints})
