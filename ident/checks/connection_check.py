"""Check of a connection for `dynid check --connect`: identities, rates, limits, gains; no drive is enabled."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from daq.robot.loader import RobotFile
from daq.session.connections import connection_names
from daq.session.device_limits import before_a_motion, require_same_arm
from daq.session.play import FIRST_SAMPLE_LIMIT
from daq.session.session import load_driver
from daq.session.supervisor import Limits, Supervisor
from drivers.base import DeviceLimits, Driver, Identifying, Limiting
from drivers.connection_settings import WITH
from drivers.core.arrays import FloatArray
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.errors import ConnectionFailedError, UsageError
from drivers.declaration import declared
from drivers.streams import Batch

LISTEN = 1.0
"""Time [s] over which the rate is measured; two periods of the slowest stream where that is longer."""
FEWEST_FOR_RATE = 20
RATE_AGREEMENT = 0.05
GAIN_AGREEMENT = 0.2
"""Relative differences above which a rate or a drive gain is reported as different."""


@dataclasses.dataclass(frozen=True)
class CheckedStream:
    """A stream and its first sample."""

    name: str  # of the stream
    nominal_hz: float  # rate that the driver names; 0 where it names none
    rate_hz: float | None  # as received within `LISTEN`, by the host's clock; None where too few samples arrived
    first: Mapping[str, Mapping[str, float]]  # quantity → column → value of the first sample
    units: Mapping[str, str]  # quantity → unit


@dataclasses.dataclass(frozen=True)
class CheckedConnection:
    """Outcome of the check of a connection."""

    name: str  # of the connection
    driver: str  # name of its driver
    identities: tuple[Mapping[str, Any], ...]  # of each device, as far as the driver can read them
    streams: tuple[CheckedStream, ...]  # checked
    # quantity → limits of the joints that the controller or its drives tell of their own
    limits: Mapping[str, Mapping[str, float]]
    notices: tuple[str, ...]  # of the driver, level first
    warnings: tuple[str, ...]  # inconsistencies with the robot file, in words


def check_connections(
    robot_file: RobotFile,
    wire: str | None,
    host: str | None = None,
    clock: Clock = SYSTEM_CLOCK,
    *,
    reset_faults: bool = False,
    configure: bool = False,
) -> list[CheckedConnection]:
    """Open a connection, the robot file's first where None, and those that it is recorded with, in turn, and listen.

    Faults of its drives are reset, and the permanent memory of its devices is written, as its driver declares.

    Raises:
        UsageError: no such connection, or its keys are wrong.
        MotionRefusedError: somebody else uses its devices.
        ConnectionFailedError: no answer, the wrong device, or no sample arrives.
        ConnectionLostError: it broke.
    """
    first, *others = connection_names(robot_file.robot, wire, robot_file.where)
    checked = [check_connection(robot_file, first, host, clock, reset_faults=reset_faults, configure=configure)]
    return checked + [check_connection(robot_file, name, clock=clock) for name in others]


def check_connection(
    robot_file: RobotFile,
    name: str,
    host: str | None = None,
    clock: Clock = SYSTEM_CLOCK,
    *,
    reset_faults: bool = False,
    configure: bool = False,
) -> CheckedConnection:
    """Open one connection and listen; arguments as of `check_connections`.

    Raises:
        UsageError, MotionRefusedError, ConnectionFailedError, ConnectionLostError: as `check_connections`.
    """
    robot = robot_file.robot
    kind = robot.connections[name].driver
    declaration = declared(kind, f"{robot_file.where}: connections.{name}.driver")
    more: dict[str, object] = {}
    for wanted, keys, what, flag in (
        (reset_faults, declaration.reset_faults, "reset faults", "--reset-faults"),
        (configure, declaration.configure, "configure devices", "--configure"),
    ):
        if wanted and not keys:
            raise UsageError(
                f"the driver '{kind}' cannot {what}",
                where=f"{robot_file.where}: connections.{name}",
                hint=f"leave {flag} out",
            )
        more |= keys if wanted else {}
    alone = robot.connections[name].model_copy(update={WITH: [], **more})
    changed = robot.model_copy(update={"connections": {**robot.connections, name: alone}})
    driver = load_driver(changed, name, host, robot_file.folder, clock, robot_file.where, moves=False)
    try:
        driver.open()
        require_same_arm(robot_file, driver)
        identities: tuple[Mapping[str, Any], ...] = ()
        if isinstance(driver, Identifying):
            identities = tuple(
                dataclasses.asdict(identity)
                for identity in driver.identify()
                if dataclasses.is_dataclass(identity) and not isinstance(identity, type)
            )
        own = driver.device_limits() if isinstance(driver, Limiting) else None
        to_mind = [*before_a_motion(robot, driver), *declaration.check_open(driver)]
        driver.start()
        batches = _listen(driver, name, clock)
        driver.stop()
        layouts = driver.streams()
        notices = tuple(f"{notice.level}: {notice.message}" for notice in driver.notices())
    finally:
        with suppress(Exception):
            driver.close()
    streams = []
    for layout in layouts:
        received = [batch for batch in batches if batch.stream == layout.name and len(batch.time)]
        first = {
            channel.quantity: dict(zip(channel.columns, received[0].values[channel.quantity][0].tolist(), strict=True))
            for channel in (layout.channels if received else ())
        }
        units = {channel.quantity: robot.column_unit(channel.unit, channel.columns) for channel in layout.channels}
        streams.append(CheckedStream(layout.name, layout.rate, _rate(received), first, units))
    warnings = _rate_warnings(streams) + _limit_warnings(
        Supervisor(Limits.of_robot(robot), layouts), batches, clock.now()
    )
    warnings += _gain_warnings(robot_file, identities) + to_mind
    limits = {} if own is None else _limits_told(robot.joint_names, own)
    return CheckedConnection(name, kind, identities, tuple(streams), limits, notices, tuple(warnings))


def _listen(driver: Driver, name: str, clock: Clock) -> list[Batch]:
    slowest = min((layout.rate for layout in driver.streams() if layout.rate > 0), default=np.inf)
    wait, listen = max(FIRST_SAMPLE_LIMIT, 3.0 / slowest), max(LISTEN, 2.0 / slowest)
    batches: list[Batch] = []
    end = clock.now() + wait
    began = False
    while clock.now() < end:
        batches += driver.read(0.05)
        if not began and any(len(batch.time) for batch in batches):
            began, end = True, clock.now() + listen
    if not began:
        raise ConnectionFailedError(f"it is open, but no sample arrived within {wait:g} s", where=f"connection {name}")
    return batches


def _limits_told(joints: Sequence[str], own: DeviceLimits) -> dict[str, dict[str, float]]:
    """Quantity with unit → joint → limit; quantities without limits are left out."""
    stated = {
        "lowest [rad]": own.lowest,
        "highest [rad]": own.highest,
        "velocity [rad/s]": own.velocity,
        "acceleration [rad/s²]": own.acceleration,
        "torque [N·m]": own.torque,
        "following error [rad]": own.following_error,
        "stop [rad/s²]": own.stopping,
    }
    return {
        name: {joint: value for joint, value in zip(joints, values.tolist(), strict=True) if value == value}
        for name, values in stated.items()
        if values is not None and np.isfinite(values).any()
    }


def _rate(batches: list[Batch]) -> float | None:
    stamps: FloatArray = np.concatenate([batch.host_time for batch in batches] or [np.empty(0)])
    if len(stamps) < FEWEST_FOR_RATE or stamps[-1] <= stamps[0]:
        return None
    lost = sum(batch.lost for batch in batches[1:])
    return float((len(stamps) - 1 + lost) / (stamps[-1] - stamps[0]))


def _rate_warnings(streams: list[CheckedStream]) -> list[str]:
    warnings = []
    for stream in streams:
        if not stream.first:
            warnings.append(f"stream {stream.name}: no sample arrived")
        elif (
            stream.nominal_hz > 0
            and stream.rate_hz is not None
            and abs(stream.rate_hz / stream.nominal_hz - 1.0) > RATE_AGREEMENT
        ):
            text = f"arrives at {stream.rate_hz:.4g} Hz instead of the nominal {stream.nominal_hz:.4g} Hz"
            warnings.append(f"stream {stream.name}: {text}")
    return warnings


def _limit_warnings(supervisor: Supervisor, batches: list[Batch], now: float) -> list[str]:
    breaches = [supervisor.check(batch, now) for batch in batches if len(batch.time)]
    reported = {(breach.what, breach.joint): str(breach) for breach in reversed(breaches) if breach is not None}
    return [f"already beyond the robot file's limit: {text}" for text in reported.values()]


def _gain_warnings(robot_file: RobotFile, identities: tuple[Mapping[str, Any], ...]) -> list[str]:
    """Warn where a drive's rated torque over its rated current is not the robot file's gain."""
    warnings = []
    for identity in identities:
        current, torque, joint = (identity.get(key) for key in ("rated_current", "rated_torque", "joint"))
        if not current or not torque or joint not in robot_file.robot.joint_names:
            continue
        drive = robot_file.robot.drive(joint)
        if drive.gain is None or drive.signal != "current":
            continue
        if abs(torque / current / abs(drive.gain) - 1.0) > GAIN_AGREEMENT:
            unit = robot_file.robot.column_unit("N·m/A", [joint])
            warnings.append(
                f"drive gain of {joint}: {abs(drive.gain):.4g} {unit} in 'drives', but the rated torque over the rated "
                f"current is {torque / current:.4g} {unit}; does one of them refer to the motor side of the gearbox?"
            )
    return warnings
