"""What `dynid check --connect` finds at the other end of a connection; nothing is enabled and nothing moved."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import numpy as np

from daq.commands.console import print_table
from daq.robot.loader import RobotFile
from daq.session.connections import connection_names
from daq.session.session import load_driver
from daq.session.supervisor import Limits, Supervisor
from drivers.base import Driver, Identifying
from drivers.clock import SYSTEM_CLOCK, Clock
from drivers.config import WITH
from drivers.errors import ConnectionFailedError
from drivers.streams import Batch, FloatArray

FIRST_SAMPLE_LIMIT = 5.0
"""How long [s] the first sample may take."""
LISTEN = 1.0
"""How long [s] is listened for the rate; two periods of the slowest stream where that is longer."""
FEWEST_FOR_RATE = 20
RATE_AGREEMENT = 0.05
GAIN_AGREEMENT = 0.2
"""Relative differences from which on a rate or a drive gain counts as another one."""
READ_ONLY: Mapping[str, Mapping[str, object]] = {"canopen402": {"mode": "none"}}
"""Keys by driver that keep its devices from being prepared for a motion."""


@dataclasses.dataclass(frozen=True)
class StreamFound:
    """What came on a stream.

    Attributes:
        name: of the stream.
        nominal_hz: rate that the driver names; 0 where it names none.
        rate_hz: as received within `LISTEN`, by the host's clock; None where too little came.
        first: quantity → column → value of the first sample.
        units: quantity → unit.
    """

    name: str
    nominal_hz: float
    rate_hz: float | None
    first: Mapping[str, Mapping[str, float]]
    units: Mapping[str, str]


@dataclasses.dataclass(frozen=True)
class ConnectionFound:
    """What answered on a connection.

    Attributes:
        name: of the connection.
        driver: name of its driver.
        identities: what each device says of itself, as far as the driver can ask.
        streams: what came.
        notices: of the driver, level first.
        warnings: where this contradicts the robot file, in words.
    """

    name: str
    driver: str
    identities: tuple[Mapping[str, Any], ...]
    streams: tuple[StreamFound, ...]
    notices: tuple[str, ...]
    warnings: tuple[str, ...]


def check_connections(
    robot_file: RobotFile, wire: str | None, host: str | None = None, clock: Clock = SYSTEM_CLOCK
) -> list[ConnectionFound]:
    """Open a connection, and those that it is recorded with, one after the other, and listen.

    Args:
        robot_file: names the connections.
        wire: which of them; the first where None.
        host: in place of the connection's own.
        clock: the host's.

    Raises:
        UsageError: no such connection, or its keys are wrong.
        ConnectionFailedError: nobody answers, somebody else does, or no sample comes.
        ConnectionLostError: it broke.
    """
    first, *others = connection_names(robot_file.robot, wire)
    found = [check_connection(robot_file, first, host, clock)]
    return found + [check_connection(robot_file, name, clock=clock) for name in others]


def check_connection(
    robot_file: RobotFile, name: str, host: str | None = None, clock: Clock = SYSTEM_CLOCK
) -> ConnectionFound:
    """Open one connection and listen; arguments as of `check_connections`.

    Raises:
        UsageError, ConnectionFailedError, ConnectionLostError: as `check_connections`.
    """
    robot = robot_file.robot
    kind = robot.connections[name].driver
    alone = robot.connections[name].model_copy(update={WITH: [], **READ_ONLY.get(kind, {})})
    changed = robot.model_copy(update={"connections": {**robot.connections, name: alone}})
    driver, _ = load_driver(changed, name, host, robot_file.folder, clock)
    try:
        driver.open()
        identities: tuple[Mapping[str, Any], ...] = ()
        if isinstance(driver, Identifying):
            identities = tuple(
                dataclasses.asdict(one)
                for one in driver.identify()
                if dataclasses.is_dataclass(one) and not isinstance(one, type)
            )
        driver.start()
        blocks = _listen(driver, name, clock)
        driver.stop()
        layouts = driver.streams()
        notices = tuple(f"{notice.level}: {notice.message}" for notice in driver.notices())
    finally:
        with suppress(Exception):
            driver.close()
    streams = []
    for layout in layouts:
        came = [block for block in blocks if block.stream == layout.name and len(block.time)]
        first = {
            channel.quantity: dict(zip(channel.columns, came[0].values[channel.quantity][0].tolist(), strict=True))
            for channel in (layout.channels if came else ())
        }
        units = {channel.quantity: channel.unit for channel in layout.channels}
        streams.append(StreamFound(layout.name, layout.rate, _rate(came), first, units))
    warnings = _rate_warnings(streams) + _limit_warnings(
        Supervisor(Limits.of_robot(robot), layouts), blocks, clock.now()
    )
    return ConnectionFound(
        name, kind, identities, tuple(streams), notices, tuple(warnings + _gain_warnings(robot_file, identities))
    )


def print_connection(found: ConnectionFound) -> None:
    """What answered, for a person."""
    print(f"\nconnection {found.name} ({found.driver}) answers")
    for identity in found.identities:
        shown = {key.replace("_", " "): value for key, value in identity.items() if value not in (None, "")}
        print(
            "  "
            + ", ".join(
                f"{key} {value:.10g}" if isinstance(value, float) else f"{key} {value}" for key, value in shown.items()
            )
        )
    for stream in found.streams:
        rate = "" if stream.rate_hz is None else f" at {stream.rate_hz:.4g} Hz"
        stated = f" (stated: {stream.nominal_hz:.4g} Hz)" if stream.nominal_hz > 0 else ""
        print(f"  stream {stream.name}{rate}{stated}; first sample:")
        alike: dict[tuple[str, ...], list[str]] = {}
        for quantity, values in stream.first.items():
            alike.setdefault(tuple(values), []).append(quantity)
        for columns, quantities in alike.items():
            headers = [f"{quantity} [{stream.units[quantity]}]" for quantity in quantities]
            rows = [(column, *(stream.first[quantity][column] for quantity in quantities)) for column in columns]
            print_table("", ("", *headers), rows)
    for notice in found.notices:
        print(f"  {notice}")
    for warning in found.warnings:
        print(f"  warning: {warning}")
    if not found.warnings:
        print("  nothing contradicts the robot file")


def _listen(driver: Driver, name: str, clock: Clock) -> list[Batch]:
    slowest = min((layout.rate for layout in driver.streams() if layout.rate > 0), default=np.inf)
    wait, listen = max(FIRST_SAMPLE_LIMIT, 3.0 / slowest), max(LISTEN, 2.0 / slowest)
    blocks: list[Batch] = []
    end = clock.now() + wait
    began = False
    while clock.now() < end:
        blocks += driver.read(0.05)
        if not began and any(len(block.time) for block in blocks):
            began, end = True, clock.now() + listen
    if not began:
        raise ConnectionFailedError(f"it is open, but no sample came within {wait:g} s", where=f"connection {name}")
    return blocks


def _rate(blocks: list[Batch]) -> float | None:
    stamps: FloatArray = np.concatenate([block.host_time for block in blocks] or [np.empty(0)])
    if len(stamps) < FEWEST_FOR_RATE or stamps[-1] <= stamps[0]:
        return None
    lost = sum(block.lost for block in blocks[1:])
    return float((len(stamps) - 1 + lost) / (stamps[-1] - stamps[0]))


def _rate_warnings(streams: list[StreamFound]) -> list[str]:
    found = []
    for stream in streams:
        if not stream.first:
            found.append(f"stream {stream.name}: no sample came")
        elif (
            stream.nominal_hz > 0
            and stream.rate_hz is not None
            and abs(stream.rate_hz / stream.nominal_hz - 1.0) > RATE_AGREEMENT
        ):
            text = f"comes at {stream.rate_hz:.4g} Hz, but {stream.nominal_hz:.4g} Hz is stated"
            found.append(f"stream {stream.name}: {text}")
    return found


def _limit_warnings(supervisor: Supervisor, blocks: list[Batch], now: float) -> list[str]:
    breaches = [supervisor.check(block, now) for block in blocks if len(block.time)]
    told = {(breach.what, breach.joint): str(breach) for breach in reversed(breaches) if breach is not None}
    return [f"the robot file's limit is passed already: {text}" for text in told.values()]


def _gain_warnings(robot_file: RobotFile, identities: tuple[Mapping[str, Any], ...]) -> list[str]:
    """Where a drive's rated torque over its rated current is not the robot file's gain."""
    found = []
    for identity in identities:
        current, torque, joint = (identity.get(key) for key in ("rated_current", "rated_torque", "joint"))
        if not current or not torque or joint not in robot_file.robot.joint_names:
            continue
        drive = robot_file.robot.drive(joint)
        if drive.gain is None or drive.signal != "current":
            continue
        if abs(torque / current / abs(drive.gain) - 1.0) > GAIN_AGREEMENT:
            found.append(
                f"drive gain of {joint}: {abs(drive.gain):.4g} N·m/A in 'drives', but the rated torque over the rated "
                f"current is {torque / current:.4g} N·m/A; is one of them on the motor's side of the gear?"
            )
    return found
