"""A simulated serial thermometer: lines of text, as fast as its baud rate allows.

A pseudo-terminal carries any number of characters per second; so they are handed over one after the other, ten bit
times each.
"""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Self

import numpy as np

from daq.robot.loader import RobotFile
from daq.robot.schema import Robot
from daq.session.connections import keys_of_driver
from drivers.core.arrays import FloatArray
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.errors import UsageError
from drivers.core.units import ZERO_CELSIUS
from drivers.serial_port import BITS_A_BYTE
from drivers.serial_thermometer.settings import ThermometerSettings, parse_settings
from sim_drivers.faults import Fault
from sim_drivers.plant.plant import Plant
from sim_drivers.pseudo_terminal import PseudoTerminal
from sim_drivers.served import Served, SimOptions
from sim_drivers.server import FaultyServer

WORD = "thermometer"
"""First word of a fault that concerns the thermometer, where it is beside an arm."""
SLICE = 0.002
"""[s] between two portions of characters."""
NOISE_BYTES = bytes(range(256))


@dataclass(frozen=True)
class SimulatedThermometer:
    """Lines of the thermometer."""

    channels: tuple[str, ...]  # one per value, in the order of the temperatures
    rate: float = 5.0  # lines per second
    baudrate: int = 9600  # [bit/s]
    template: str = "T{channel}={value:.2f}"  # of one value; `channel` and `value` in the unit
    separator: str = " "  # between the values of a line
    unit: str = "degC"  # degC, degF or K

    def line(self, celsius: Sequence[float] | FloatArray) -> bytes:
        """A line with these temperatures [°C], one per channel."""
        convert: Mapping[str, Callable[[float], float]] = {
            "degC": lambda value: value,
            "degF": lambda value: 1.8 * value + 32.0,
            "K": lambda value: value + ZERO_CELSIUS,
        }
        values = [
            self.template.format(channel=channel, value=convert[self.unit](float(value)))
            for channel, value in zip(self.channels, celsius, strict=True)
        ]
        return (self.separator.join(values) + "\r\n").encode("ascii")


class ThermometerServer(FaultyServer):
    """A thermometer on a serial line; `start` plugs it in, `stop` ends it.

    Args:
        source: an arm whose joints' housings are measured, all of them in their order, or a function that gives the
            temperatures [°C], one per channel.
        settings: of the lines.
        seed: of the garbage.
        line_end: its end of the line; a pseudo-terminal where None.
        clock: the host's.

    Attributes:
        lines: sent whole, garbage not counted.
        lost: lines that no client read.

    Raises:
        UsageError: so many lines do not fit through the baud rate.
    """

    def __init__(
        self,
        source: Plant | Callable[[], Sequence[float] | FloatArray],
        settings: SimulatedThermometer,
        seed: int = 0,
        line_end: PseudoTerminal | None = None,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        super().__init__("thermometer", (), clock)
        self.settings = settings
        self.lines = 0
        self.lost = 0
        self._temperatures = (lambda: source.thermal.housing) if isinstance(source, Plant) else source
        length = len(settings.line(np.full(len(settings.channels), -100.0)))
        if length * settings.rate * BITS_A_BYTE > settings.baudrate:
            raise UsageError(
                f"{settings.rate:g} lines per second of {length} characters exceed {settings.baudrate} bit/s",
                hint=f"at most {settings.baudrate / (BITS_A_BYTE * length):.3g} lines per second",
            )
        self._random = random.Random(seed)
        self._line_end = PseudoTerminal() if line_end is None else line_end
        self._changed = clock.condition()
        self._silent_until = self._garbage_until = 0.0
        self._replug_at = math.inf

    @property
    def path(self) -> str:
        """Path of the port; it stays the same when the thermometer is unplugged and plugged in again."""
        return self._line_end.path

    def ready(self) -> Mapping[str, object]:
        """Address for clients."""
        return {"thermometer": self.path, "thermometer_baudrate": self.settings.baudrate}

    def live_line(self) -> str:
        """Return its state in one line."""
        lost = f", {self.lost} that no client read" if self.lost else ""
        return f"thermometer {self.path}: {self.lines} lines{lost}"

    def unplug(self, duration: float | None = None) -> None:
        """Pull it out; it comes back after `duration` [s], or with `replug`."""
        with self._changed:
            self._replug_at = math.inf if duration is None else self._clock.now() + duration
            self._line_end.pull_out()
            self._changed.notify_all()

    def replug(self) -> None:
        """Plug it in again; nothing where it is plugged in."""
        with self._changed:
            self._plug_in()

    def obey(self, line: str) -> None:
        """Cause a typed fault at once."""
        try:
            super().obey(line)
        except UsageError as error:
            error.hint = f"{WORD} {error.hint}"  # beside an arm it says whose fault is meant
            raise

    def cause(self, fault: Fault) -> None:
        """Apply a fault at once; from any thread."""
        match fault:
            case Fault("silent", (duration,)):
                self._silent_until = self._clock.now() + duration
            case Fault("garbage", (duration,)):
                self._garbage_until = self._clock.now() + duration
            case Fault("stick", ()):
                celsius = np.array(self._temperatures())
                self._temperatures = lambda: celsius
            case Fault("unplug", duration):
                self.unplug(*duration)
            case Fault("replug", ()):
                self.replug()
            case _:
                self._not_caused(fault)

    def _work(self) -> Mapping[str, Callable[[], None]]:
        return {"thermometer": self._send}

    def _open(self) -> None:
        self.replug()

    def _wake(self) -> None:
        with self._changed:
            self._changed.notify_all()

    def _close(self) -> None:
        self.unplug()
        self._line_end.remove()

    def _send(self) -> None:
        period = 1.0 / self.settings.rate
        byte_time = BITS_A_BYTE / self.settings.baudrate
        due = free = self._clock.now()
        waiting = bytearray()
        while not self._stopping.is_set():
            now = self._clock.now()
            with self._changed:
                if now >= self._replug_at:
                    self._plug_in()
            while due <= now:
                if not waiting:
                    free = max(free, due)
                waiting += self._next_line(now)
                due += period
            count = min(int((now - free) / byte_time), len(waiting))
            if count > 0:
                self._write(bytes(waiting[:count]))
                del waiting[:count]
                free += count * byte_time
            with self._changed:
                if not self._stopping.is_set():
                    self._changed.wait(min(now + SLICE if waiting else due, self._replug_at) - now)

    def _plug_in(self) -> None:
        self._replug_at = math.inf
        self._line_end.plug_in()

    def _next_line(self, now: float) -> bytes:
        if now < self._silent_until:
            return b""
        line = self.settings.line(self._temperatures())
        if now < self._garbage_until:
            return bytes(self._random.choices(NOISE_BYTES, k=len(line)))
        return line

    def _write(self, data: bytes) -> None:
        with self._changed:
            sent = self._line_end.write(data)
        self.lines += data[:sent].count(b"\n")
        self.lost += data[sent:].count(b"\n")


def simulated_thermometer(connection: Mapping[str, object], joints: Sequence[str]) -> SimulatedThermometer:
    """Settings for the thermometer of a connection: the channels of all joints that it names, in joint order.

    Raises:
        UsageError: the connection's keys are wrong, or its pattern does not match the lines.
    """
    settings = parse_settings(connection, joints)
    simulated = SimulatedThermometer(
        tuple(_by_joint(settings, joints)), settings.rate, settings.baudrate, unit=settings.unit
    )
    line = simulated.line([20.0] * len(simulated.channels)).decode("ascii")
    channels = [match["channel"] for match in settings.pattern.finditer(line)]
    if channels != list(simulated.channels):
        raise UsageError(
            f"the simulated thermometer sends lines such as {line.strip()!r}, which 'pattern' does not match",
            hint=r"for the simulation take T(?P<channel>\w+)=(?P<value>[-+.\d]+)",
        )
    return simulated


def serve_thermometer(
    plant: Plant,
    connection: Mapping[str, object],
    seed: int = 0,
    line_end: PseudoTerminal | None = None,
    clock: Clock = SYSTEM_CLOCK,
) -> ThermometerServer:
    """A thermometer, not yet started, on an arm: the joints that a robot file's connection names.

    Without a `line_end` it is on a pseudo-terminal, which appears where the connection's `url` says, if that is the
    path of no device.

    Raises:
        UsageError: as `simulated_thermometer`, so many lines do not fit through the baud rate, or something else is
            where the port should appear.
    """
    joints = plant.robot.joint_names
    settings = parse_settings(connection, joints)
    columns = [joints.index(joint) for joint in _by_joint(settings, joints).values()]
    simulated = simulated_thermometer(connection, joints)
    line_end = PseudoTerminal.at(settings.url) if line_end is None else line_end
    return ThermometerServer(lambda: plant.thermal.housing[columns], simulated, seed, line_end, clock)


def _by_joint(settings: ThermometerSettings, joints: Sequence[str]) -> dict[str, str]:
    """Channel → joint, in the order of the joints."""
    return dict(sorted(settings.channels.items(), key=lambda item: joints.index(item[1])))


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
        return {**self._served.ready(), **self._thermometer.ready()}

    def live_line(self) -> str:
        """The state of both in one line."""
        return f"{self._served.live_line()}; {self._thermometer.live_line()}"

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
        return self._thermometer.ready()

    def live_line(self) -> str:
        """Return its state in one line."""
        return self._thermometer.live_line()

    def obey(self, line: str) -> None:
        """Request a fault; the word `thermometer` may precede it."""
        super().obey(line.strip().removeprefix(f"{WORD} "))

    def cause(self, fault: Fault) -> None:
        """Apply a fault: heat at the plant's next period, all others at once."""
        if fault.word == "heat":
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
                self._plant.heat(*fault.values)
            self._plant.advance(PERIOD)


def serve(
    robot_file: RobotFile,
    plant: Plant,
    options: SimOptions,
    clock: Clock = SYSTEM_CLOCK,
    line_end: PseudoTerminal | None = None,
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
