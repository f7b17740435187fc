"""What a driver package declares, once, in the entry-point group `dynid.drivers`, and where dynid looks it up.

Functions that not every command needs are given as `module:name` and imported when they are called for, so that
looking through all declarations costs next to nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from drivers.base import Driver, DriverSettings
from drivers.bus_budget import Budget
from drivers.core.errors import UsageError

DRIVERS_GROUP = "dynid.drivers"
"""Entry-point group: driver name, as robot files have it → `DriverDeclaration`."""


@dataclass(frozen=True)
class SimulatedBackEnd:
    """How `dynid sim` serves simulated devices on a bus.

    Attributes:
        wire: word of `dynid sim --wire`.
        serve: `module:function` of (RobotFile, Plant, SimOptions, Clock), which returns what is served, not started yet
            (`sim_drivers.served.Served`); raises UsageError where the connection or the options are wrong, and
            RobotFileError where the truth lacks what the devices need.
        beside: `module:function` of (Served, RobotFile, Plant, SimOptions, Clock), which serves its device beside an
            arm on another bus; empty where it cannot.
        arm: whether it is the arm that answers; else a sensor on it.
        stands_in: whether it also serves arms whose robot file has no connection of this driver.
        turning: the arm that it stands in for has so many joints, all of which turn; any arm where None.
    """

    wire: str
    serve: str
    beside: str = ""
    arm: bool = True
    stands_in: bool = False
    turning: int | None = None


@dataclass(frozen=True)
class DriverDeclaration:
    """What dynid knows of a driver and its bus.

    Attributes:
        driver: (DriverSettings) -> Driver, or its `module:name`; raises UsageError where the connection's keys are
            wrong.
        budget: `module:function` of (DriverSettings), which returns the load of the bus (`Budget`), and raises as
            `driver`; empty where the bus cannot be too full.
        read_only: keys of the connection with which the driver prepares nothing for a motion, and sends no device
            anything that could end another program's; they replace the robot file's where the arm is not to be moved.
        reset_faults: keys with which opening resets faults of the devices and enables nothing; empty where it cannot.
        configure: keys with which opening writes what a motion needs into the devices' permanent memory, and nothing
            else does; empty where it cannot.
        advice: `module:function` of (DriverSettings), which returns what `dynid check` warns of, one line each, while
            nothing is opened: settings of this computer, of an adapter; empty where there is none.
        connection_check: `module:function` of (Driver), which is open, and returns what `dynid check --connect` warns
            of, one line each; nothing may move or be enabled. Empty where there is none.
        port: of a connection with the key `host` and without `port`: its TCP port, by which two programs know that
            they mean the same arm; 0 where it has none.
        simulated: its simulated back ends; the first is the usual one.
    """

    driver: str | Callable[[DriverSettings], Driver]
    budget: str = ""
    read_only: Mapping[str, object] = field(default_factory=dict)
    reset_faults: Mapping[str, object] = field(default_factory=dict)
    configure: Mapping[str, object] = field(default_factory=dict)
    advice: str = ""
    connection_check: str = ""
    port: int = 0
    simulated: tuple[SimulatedBackEnd, ...] = ()

    def make(self, settings: DriverSettings) -> Driver:
        """The driver of a connection, not open yet.

        Raises:
            UsageError: the connection's keys are wrong.
        """
        made: Driver = (named(self.driver) if isinstance(self.driver, str) else self.driver)(settings)
        return made

    def budget_of(self, settings: DriverSettings) -> Budget | None:
        """Return what a connection asks of its bus; None where the bus cannot be too full.

        Raises:
            UsageError: the connection's keys are wrong.
        """
        budget: Budget | None = named(self.budget)(settings) if self.budget else None
        return budget

    def advice_on(self, settings: DriverSettings) -> Sequence[str]:
        """Return what `dynid check` warns of while nothing is opened, one line each."""
        advice: Sequence[str] = named(self.advice)(settings) if self.advice else ()
        return advice

    def check_open(self, driver: Driver) -> Sequence[str]:
        """Return what `dynid check --connect` warns of an open driver, one line each."""
        warnings: Sequence[str] = named(self.connection_check)(driver) if self.connection_check else ()
        return warnings


def named(place: str) -> Any:
    """The object at `module:name`."""
    return EntryPoint(place, place, DRIVERS_GROUP).load()


def installed_drivers() -> dict[str, EntryPoint]:
    """Entry points of the installed drivers by name, not loaded."""
    return {entry.name: entry for entry in entry_points(group=DRIVERS_GROUP)}


def declared(driver: str, where: str = "") -> DriverDeclaration:
    """The declaration of an installed driver.

    `where` is the file and key that name it, for messages.

    Raises:
        UsageError: no such driver is installed, or its package cannot be imported or declares something else.
    """
    installed = installed_drivers()
    if driver not in installed:
        raise UsageError(
            f"no driver is called '{driver}'", where=where, hint=f"installed: {', '.join(sorted(installed)) or 'none'}"
        )
    entry = installed[driver]
    try:
        loaded = entry.load()
    except (ImportError, AttributeError, SyntaxError) as error:
        raise UsageError(
            f"the driver '{driver}' cannot be loaded: {error}", where=where, hint="install its package again"
        ) from error
    if not isinstance(loaded, DriverDeclaration):
        raise UsageError(
            f"the entry point of the driver '{driver}' is not a DriverDeclaration",
            where=where,
            hint=f"{entry.value} is {type(loaded).__name__}: pip install its package again, or see docs/drivers.md",
        )
    return loaded
