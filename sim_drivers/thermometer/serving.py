"""`dynid sim` with a thermometer: alone on an arm at rest, or beside an arm that is served on its own bus."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from typing import Self

from daq.robot.loader import RobotFile
from daq.robot.schema import Robot
from daq.session.connections import keys_of_driver
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.errors import UsageError
from sim_drivers.faults import Fault, Heat
from sim_drivers.plant.plant import Plant
from sim_drivers.served import Served, SimOptions
from sim_drivers.server import FaultyServer
from sim_drivers.thermometer.server import WORD, ThermometerServer, WritableLineEnd, serve_thermometer

DRIVER = "serial_thermometer"
PERIOD = 0.02
"""[s] between two advances of an arm that nothing but its thermometer watches."""


class BesideThermometer:
    """An arm on its bus and a thermometer on the same arm, served together."""

    def __init__(self, served: Served, thermometer: ThermometerServer) -> None:
        self._served, self._thermometer = served, thermometer
        self.messages = served.messages
        self._both = ExitStack()

    @property
    def failure(self) -> BaseException | None:
        """The error that ended one of them; None while they run."""
        return self._served.failure or self._thermometer.failure

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            stack.enter_context(self._served)
            stack.enter_context(self._thermometer)
            self._both = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._both.close()

    def ready(self) -> Mapping[str, object]:
        """Addresses for clients."""
        return {**self._served.ready(), **_ready(self._thermometer)}

    def live_line(self) -> str:
        """The state of both in one line."""
        return f"{self._served.live_line()}; {_live_line(self._thermometer)}"

    def obey(self, line: str) -> None:
        """Cause a fault; the thermometer's begin with the word `thermometer`."""
        first, _, rest = line.strip().partition(" ")
        if first == WORD:
            self._thermometer.obey(rest)
        else:
            self._served.obey(line)


class ThermometerAlone(FaultyServer):
    """A thermometer on an arm at rest; `heat JOINT CELSIUS` warms a joint up."""

    def __init__(self, plant: Plant, thermometer: ThermometerServer, clock: Clock = SYSTEM_CLOCK) -> None:
        super().__init__("arm at rest", plant.robot.joint_names, clock, beside=(thermometer,))
        self._plant, self._thermometer = plant, thermometer

    def ready(self) -> Mapping[str, object]:
        """Address for clients."""
        return _ready(self._thermometer)

    def live_line(self) -> str:
        """Return its state in one line."""
        return _live_line(self._thermometer)

    def obey(self, line: str) -> None:
        """Request a fault; the word `thermometer` may precede it."""
        super().obey(line.strip().removeprefix(f"{WORD} "))

    def cause(self, fault: Fault) -> None:
        """Apply a fault: heat at the plant's next period, all others at once."""
        if isinstance(fault, Heat):
            super().cause(fault)
        else:
            self._thermometer.cause(fault)

    def _work(self) -> Mapping[str, Callable[[], None]]:
        return {"plant": self._advance}

    def _advance(self) -> None:
        begun = self._clock.now()
        for count in itertools.count(1):  # on a grid, so that no lateness accumulates
            if self._stopping.wait(begun + count * PERIOD - self._clock.now()):
                return
            for fault in self._new_faults():
                if isinstance(fault, Heat):
                    self._plant.heat(fault.joint, fault.celsius)
            self._plant.advance(PERIOD)


def serve(
    robot_file: RobotFile,
    plant: Plant,
    options: SimOptions,
    clock: Clock = SYSTEM_CLOCK,
    line_end: WritableLineEnd | None = None,
) -> ThermometerAlone:
    """The thermometer of a robot file, on its arm at rest; its end of the line is a pseudo-terminal where None."""
    keys = thermometer_keys(robot_file.robot)
    return ThermometerAlone(plant, serve_thermometer(plant, keys, options.seed, line_end, clock), clock)


def serve_beside(
    served: Served, robot_file: RobotFile, plant: Plant, options: SimOptions, clock: Clock
) -> BesideThermometer:
    """The thermometer of a robot file beside its arm, which is served on its own bus."""
    keys = thermometer_keys(robot_file.robot)
    return BesideThermometer(served, serve_thermometer(plant, keys, options.seed, clock=clock))


def thermometer_keys(robot: Robot) -> Mapping[str, object]:
    """The keys of a robot file's first serial thermometer.

    Raises:
        UsageError: it has none.
    """
    if (keys := keys_of_driver(robot, DRIVER)) is not None:
        return keys
    raise UsageError(
        "the robot file has no serial thermometer",
        where=f"{robot.name}: connections",
        hint=f"add one: driver: {DRIVER}",
    )


def _ready(thermometer: ThermometerServer) -> Mapping[str, object]:
    return {"thermometer": thermometer.path, "thermometer_baudrate": thermometer.settings.baudrate}


def _live_line(thermometer: ThermometerServer) -> str:
    lost = f", {thermometer.lost} that no client read" if thermometer.lost else ""
    return f"thermometer {thermometer.path}: {thermometer.lines} lines{lost}"
