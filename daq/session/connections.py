"""The connections of a robot file: which belong to one session, and their drivers' settings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from daq.robot.loops import coupling_matrix
from daq.robot.schema import Connection, Robot
from drivers.base import DriverSettings
from drivers.connection_settings import WITH
from drivers.core.errors import UsageError
from drivers.declaration import declared
from drivers.gains import DriveGain


def connection_names(robot: Robot, wire: str | None = None, place: str = "") -> list[str]:
    """A connection's name, the first one's where `wire` is None, and those that it is recorded with.

    `place` is the robot file in messages; its name where empty.

    Raises:
        UsageError: no such connection.
    """
    place = place or robot.name
    if not robot.connections:
        raise UsageError("the robot file has no connection", where=f"{place}: connections")
    name = wire if wire is not None else next(iter(robot.connections))
    where = place
    known = ", ".join(robot.connections)
    if name not in robot.connections:
        raise UsageError(f"no connection is called '{name}'", where=where, hint=f"there are: {known}")
    given = (robot.connections[name].model_extra or {}).get(WITH, [])
    where = f"{place}: connections.{name}.{WITH}"
    if not isinstance(given, list) or not all(isinstance(name_beside, str) for name_beside in given):
        raise UsageError(
            f"is {given!r}, but should be a list of connections", where=where, hint=f"such as {WITH}: [thermometer]"
        )
    for name_beside in given:
        if name_beside not in robot.connections:
            raise UsageError(f"no connection is called '{name_beside}'", where=where, hint=f"there are: {known}")
    if name in given or len(set(given)) < len(given):
        raise UsageError(f"names a connection twice, or itself: {', '.join(given)}", where=where)
    return [name, *given]


def connection_keys(robot: Robot, name: str, *, moves: bool = True) -> dict[str, object]:
    """A connection's keys without those of the session; where its arm is not to be moved, its driver's `read_only`.

    Raises:
        UsageError: its driver is not installed.
    """
    connection = robot.connections[name]
    keys = _without_session(connection)
    if moves:
        return keys
    return {**keys, **declared(connection.driver, f"{robot.name}: connections.{name}.driver").read_only}


def keys_of_driver(robot: Robot, driver: str) -> dict[str, object] | None:
    """The keys of a robot's first connection with a driver, without those of the session; None where there is none."""
    return next((_without_session(keys) for keys in robot.connections.values() if keys.driver == driver), None)


def _without_session(connection: Connection) -> dict[str, object]:
    return {key: value for key, value in (connection.model_extra or {}).items() if key != WITH}


@contextmanager
def errors_of_connection(robot_place: str, name: str) -> Iterator[None]:
    """Errors about a connection's keys name the connection; `robot_place` is the robot file in messages."""
    try:
        yield
    except UsageError as error:
        place = f"{robot_place}: connections.{name}"
        error.where = f"{place}: {error.where}" if error.where else place
        raise


def driver_settings(robot: Robot, keys: Mapping[str, object], folder: Path | None = None) -> DriverSettings:
    """Settings of the driver of one of a robot's connections."""
    drives = [robot.drive(joint) for joint in robot.joint_names]
    gains = tuple(DriveGain(drive.gain, drive.gain_std, drive.signal) for drive in drives)
    coupling = coupling_matrix(robot.model.coupling, robot.joint_names) if robot.model.coupling else None
    return DriverSettings(robot.joint_names, keys, gains, coupling, folder, sliding=robot.sliding)
