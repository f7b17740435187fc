"""A simulated serial thermometer: lines of text on a pseudo-terminal, as fast as its baud rate lets them through.

A pseudo-terminal itself carries any number of characters a second; so the characters are handed over one bit time after
the other, ten bits each.
"""

from __future__ import annotations

import contextlib
import os
import random
import select
import tempfile
import threading
import time
import tty
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from drivers.errors import UsageError
from drivers.serial_thermometer.port import BITS_A_CHARACTER
from drivers.serial_thermometer.settings import ThermometerSettings, parse_settings
from drivers.streams import FloatArray
from drivers.units import ZERO_CELSIUS
from sim_drivers.plant import Plant

SLICE = 0.002
"""[s] between two portions of characters."""
STOP_LIMIT = 5.0
NOISE_BYTES = bytes(range(256))
USAGE = "thermometer silent SECONDS | garbage SECONDS | unplug | unplug SECONDS | replug"


@dataclass(frozen=True)
class SimulatedThermometer:
    """What the thermometer sends.

    Attributes:
        channels: one a value, in the order of the temperatures.
        rate: lines a second.
        baudrate: [bit/s].
        template: of one value; `channel` and `value` in the unit.
        separator: between the values of a line.
        unit: degC, degF or K.
    """

    channels: tuple[str, ...]
    rate: float = 5.0
    baudrate: int = 9600
    template: str = "T{channel}={value:.2f}"
    separator: str = " "
    unit: str = "degC"

    def line(self, celsius: Sequence[float] | FloatArray) -> bytes:
        """A line with these temperatures [°C], one a channel."""
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


class ThermometerServer:
    """A thermometer on a pseudo-terminal; `start` plugs it in, `stop` ends it.

    Args:
        source: an arm whose joints' housings are measured, all of them in their order, or a function that gives the
            temperatures [°C], one a channel.
        settings: what is sent.
        seed: of the garbage.
        path: where the port appears; a folder of its own where None.

    Attributes:
        path: of the port; it stays the same when the thermometer is unplugged and plugged in again.
        lines: sent whole, garbage not counted.
        lost: lines that nobody took.
        failure: what ended it; None while all is well.

    Raises:
        UsageError: so many lines do not fit through the baud rate, or something else is at `path`.
    """

    def __init__(
        self,
        source: Plant | Callable[[], Sequence[float] | FloatArray],
        settings: SimulatedThermometer,
        seed: int = 0,
        path: str | None = None,
    ) -> None:
        self.settings = settings
        self.lines = 0
        self.lost = 0
        self.failure: BaseException | None = None
        self._temperatures = (lambda: source.thermal.housing) if isinstance(source, Plant) else source
        length = len(settings.line(np.full(len(settings.channels), -100.0)))
        if length * settings.rate * BITS_A_CHARACTER > settings.baudrate:
            raise UsageError(
                f"{settings.rate:g} lines a second of {length} characters do not fit through {settings.baudrate} bit/s",
                hint=f"at most {settings.baudrate / (BITS_A_CHARACTER * length):.3g} lines a second",
            )
        self._random = random.Random(seed)
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        if path is None:
            self._folder = tempfile.TemporaryDirectory(prefix="dynid-thermometer-")
            path = str(Path(self._folder.name) / "port")
        elif os.path.exists(path):
            raise UsageError("there is something already", where=path, hint="choose another path, or remove it")
        self.path = path
        self._master: int | None = None
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._silent_until = self._garbage_until = 0.0
        self._replug_at: float | None = None
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self) -> None:
        """Plug it in and let it send."""
        if self._thread is not None:
            raise RuntimeError("started already")
        self.replug()
        self._thread = threading.Thread(target=self._run, name="thermometer", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End it; safe to call twice."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join(STOP_LIMIT)
        self.unplug()
        if self._folder is not None:
            self._folder.cleanup()

    def silent(self, duration: float) -> None:
        """Send nothing for a while [s]."""
        self._silent_until = time.monotonic() + duration

    def garbage(self, duration: float) -> None:
        """Send any bytes in place of lines for a while [s], as at a wrong baud rate."""
        self._garbage_until = time.monotonic() + duration

    def unplug(self, duration: float | None = None) -> None:
        """Pull it out; it comes back after `duration` [s], or with `replug`."""
        self._replug_at = None if duration is None else time.monotonic() + duration
        with self._lock:
            master, self._master = self._master, None
            if master is not None:
                os.close(master)
                with contextlib.suppress(FileNotFoundError):
                    os.unlink(self.path)

    def replug(self) -> None:
        """Plug it in again; nothing where it is plugged in."""
        self._replug_at = None
        with self._lock:
            if self._master is not None:
                return
            master, slave = os.openpty()
            tty.setraw(slave)
            with contextlib.suppress(FileNotFoundError):
                if os.path.islink(self.path):
                    os.unlink(self.path)  # left by one that was killed
            os.symlink(os.ttyname(slave), self.path)
            os.close(slave)
            os.set_blocking(master, False)
            self._master = master

    def obey(self, line: str) -> None:
        """Cause a fault as a person types it, without the word `thermometer`.

        Raises:
            UsageError: not a fault.
        """
        match line.split():
            case ["silent", seconds] if (duration := _positive(seconds)) is not None:
                self.silent(duration)
            case ["garbage", seconds] if (duration := _positive(seconds)) is not None:
                self.garbage(duration)
            case ["unplug"]:
                self.unplug()
            case ["unplug", seconds] if (duration := _positive(seconds)) is not None:
                self.unplug(duration)
            case ["replug"]:
                self.replug()
            case _:
                raise UsageError(f"'{line.strip()}' is not a fault of the thermometer", hint=USAGE)

    def _run(self) -> None:
        try:
            self._send()
        except BaseException as error:  # the thread ends either way; whoever started it must hear why
            self.failure = error

    def _send(self) -> None:
        period = 1.0 / self.settings.rate
        byte_time = BITS_A_CHARACTER / self.settings.baudrate
        due = free = time.monotonic()
        waiting = bytearray()
        while not self._stopping.is_set():
            now = time.monotonic()
            if self._replug_at is not None and now >= self._replug_at:
                self.replug()
            while due <= now:
                if not waiting:
                    free = max(free, due)
                waiting += self._next_line()
                due += period
            count = min(int((now - free) / byte_time), len(waiting))
            if count > 0:
                self._write(bytes(waiting[:count]))
                del waiting[:count]
                free += count * byte_time
            self._stopping.wait(SLICE if waiting else min(max(due - now, 0.0), 0.05))

    def _next_line(self) -> bytes:
        now = time.monotonic()
        if now < self._silent_until:
            return b""
        line = self.settings.line(self._temperatures())
        if now < self._garbage_until:
            return bytes(self._random.choices(NOISE_BYTES, k=len(line)))
        return line

    def _write(self, data: bytes) -> None:
        with self._lock:
            if self._master is None:
                self.lost += data.count(b"\n")
                return
            poll = select.poll()
            poll.register(self._master, select.POLLHUP)
            if any(event & select.POLLHUP for _, event in poll.poll(0)):  # nobody has the port open
                self.lost += data.count(b"\n")
                return
            with contextlib.suppress(BlockingIOError, OSError):
                os.read(self._master, 4096)  # whatever is said to it
            try:
                written = os.write(self._master, data)
            except OSError:
                written = 0
            self.lines += data[:written].count(b"\n")
            self.lost += data[written:].count(b"\n")


def simulated_thermometer(connection: Mapping[str, object], joints: Sequence[str]) -> SimulatedThermometer:
    """What a thermometer of a robot file's connection sends: the channels of all joints that it names, in joint order.

    Raises:
        UsageError: the connection's keys are wrong, or its pattern does not match what is sent.
    """
    settings = parse_settings({key: value for key, value in connection.items() if key != "with"}, joints)
    simulated = SimulatedThermometer(
        tuple(_by_joint(settings, joints)), settings.rate, settings.baudrate, unit=settings.unit
    )
    line = simulated.line([20.0] * len(simulated.channels)).decode("ascii")
    found = [match["channel"] for match in settings.pattern.finditer(line)]
    if found != list(simulated.channels):
        raise UsageError(
            f"the simulated thermometer sends lines such as {line.strip()!r}, which 'pattern' does not match",
            hint=r"for the simulation take T(?P<channel>\w+)=(?P<value>[-+.\d]+)",
        )
    return simulated


def serve_thermometer(plant: Plant, connection: Mapping[str, object], seed: int = 0) -> ThermometerServer:
    """A thermometer, not yet started, on an arm: the joints that a robot file's connection names.

    Its port appears where the connection's `url` says, if that is the path of no device.

    Raises:
        UsageError: as `simulated_thermometer`, or so many lines do not fit through the baud rate.
    """
    joints = plant.robot.joint_names
    settings = parse_settings({key: value for key, value in connection.items() if key != "with"}, joints)
    columns = [joints.index(joint) for joint in _by_joint(settings, joints).values()]
    own = os.path.isabs(settings.url) and not settings.url.startswith("/dev/")
    return ThermometerServer(
        lambda: plant.thermal.housing[columns],
        simulated_thermometer(connection, joints),
        seed,
        settings.url if own else None,
    )


def _by_joint(settings: ThermometerSettings, joints: Sequence[str]) -> dict[str, str]:
    """Channel → joint, in the order of the joints."""
    return dict(sorted(settings.channels.items(), key=lambda item: joints.index(item[1])))


def _positive(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if 0.0 < value < float("inf") else None
