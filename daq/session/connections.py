"""The connections of a robot file: those of one session, their drivers' settings, whether frames fit on the bus."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from daq.robot.loader import RobotFile
from daq.robot.loops import coupling_matrix
from daq.robot.schema import Connection, Robot
from drivers.base import DriverSettings
from drivers.bus_budget import TIGHT_SHARE, Budget
from drivers.connection_settings import WITH
from drivers.core.errors import RobotFileError, UsageError
from drivers.core.text import percent_text
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
    names = ", ".join(robot.connections)
    if name not in robot.connections:
        raise UsageError(f"no connection is called '{name}'", where=where, hint=f"there are: {names}")
    given = (robot.connections[name].model_extra or {}).get(WITH, [])
    where = f"{place}: connections.{name}.{WITH}"
    if not isinstance(given, list) or not all(isinstance(name_beside, str) for name_beside in given):
        raise UsageError(
            f"is {given!r}, but should be a list of connections", where=where, hint=f"such as {WITH}: [thermometer]"
        )
    for name_beside in given:
        if name_beside not in robot.connections:
            raise UsageError(f"no connection is called '{name_beside}'", where=where, hint=f"there are: {names}")
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


def bus_budget(robot_file: RobotFile, name: str, *, moves: bool = True) -> Budget | None:
    """Bus load of a connection, where it moves its arm or only records; None where its bus cannot be too full.

    Raises:
        UsageError: the connection's keys are wrong.
        RobotFileError: it needs more than the bus carries.
    """
    robot = robot_file.robot
    where = f"{robot_file.where}: connections.{name}"
    keys = connection_keys(robot, name, moves=moves)
    with errors_of_connection(robot_file.where, name):
        budget = declared(robot.connections[name].driver).budget_of(driver_settings(robot, keys, robot_file.folder))
    if budget is not None and budget.load > 1.0:
        raise RobotFileError(
            f"{budget.rate:g} Hz does not fit on a bus of {budget.bitrate:.0f} bit/s: {percent_text(budget.load)} of "
            "it",
            where=where,
            hint=f"at most {budget.highest_rate():.0f} Hz, better {budget.highest_rate(TIGHT_SHARE):.0f} Hz",
        )
    return budget


def tight_bus(name: str, budget: Budget) -> str | None:
    """The warning about a bus with little room left; None where there is enough."""
    if budget.load <= TIGHT_SHARE:
        return None
    return (
        f"connection '{name}' fills its bus to {percent_text(budget.load)} at worst; "
        f"at {budget.highest_rate(TIGHT_SHARE):.0f} Hz it would be {percent_text(TIGHT_SHARE)}"
    )


def session_warnings(robot_file: RobotFile, wire: str | None, *, moves: bool) -> list[str]:
    """Warnings about the buses of a session: of a connection (the first where None) and those recorded with it.

    `moves`: whether the connection's arm is to be moved.

    Raises:
        UsageError: no such connection, or its keys are wrong.
        RobotFileError: a connection needs more than its bus carries.
    """
    names = connection_names(robot_file.robot, wire, robot_file.where)
    budgets = ((name, bus_budget(robot_file, name, moves=moves and name == names[0])) for name in names)
    warnings = (tight_bus(name, budget) for name, budget in budgets if budget is not None)
    return [warning for warning in warnings if warning is not None]
