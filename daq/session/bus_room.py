"""Whether a connection's frames fit on its bus, before the bus is touched."""

from __future__ import annotations

from daq.robot.loader import RobotFile
from daq.session.connections import connection_keys, connection_names, driver_settings, errors_of_connection
from drivers.bus_budget import TIGHT_SHARE, Budget
from drivers.core.errors import RobotFileError
from drivers.core.text import percent_text
from drivers.declaration import declared


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
            f"{budget.rate:g} Hz do not fit on a bus of {budget.bitrate:.0f} bit/s: {percent_text(budget.load)} of it",
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
