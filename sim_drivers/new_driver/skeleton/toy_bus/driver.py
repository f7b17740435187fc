"""The driver: frame 0x100 + joint brings position, velocity and a counter; 0x200 + joint takes a target."""

import struct
from collections.abc import Sequence
from contextlib import ExitStack, suppress

import numpy as np
from pydantic import Field

from drivers.base import DriverSettings, Notice, require_state
from drivers.bus_budget import WORST, Budget, can_frames
from drivers.can.bus import Sender, close_bus, open_bus
from drivers.can.receiver import Receiver
from drivers.can.settings import CanSettings
from drivers.connection_settings import read_settings
from drivers.core.arrays import FloatArray
from drivers.core.errors import ConnectionFailedError, ConnectionLostError
from drivers.first_step import check_first_step, finite_position
from drivers.life_cycle import LifeCycle
from drivers.streams import Batch, ChannelLayout, StreamLayout

SAMPLE, TARGET, MODE = 0x100, 0x200, 0x300
FRAME = struct.Struct("<ihH")  # position [1e-4 rad], velocity [1e-3 rad/s], number of the period
HOLD, FOLLOW = b"\0", b"\1"
SILENT = 0.5  # [s] without a sample, after which the connection counts as lost


class ToyBusSettings(CanSettings):
    """The keys of a connection in a robot file."""

    rate: float = Field(100.0, ge=1.0, le=1000.0, description="[Hz], of the samples")


class ToyBusDriver(LifeCycle):
    """Implements `drivers.base.Driver`; how it is opened and closed, and what it then refuses, is any driver's."""

    def __init__(self, settings: DriverSettings) -> None:
        super().__init__(settings)
        self._settings = read_settings(ToyBusSettings, settings.connection, "toy_bus")
        self._opened = ExitStack()
        self._controls = self._moved = False
        self._begin()

    def _connect(self) -> None:
        bus = self._settings
        opened = open_bus(bus.interface, bus.channel, bus.bitrate, bus.options)
        self._opened.callback(close_bus, opened)
        self._sender, self._receiver = Sender(opened, self._clock), Receiver(opened, clock=self._clock)
        self._opened.callback(self._receiver.stop)
        self._receiver.start()
        if not self._receiver.take(2.0):
            raise ConnectionFailedError("no frame within 2 s", where=str(bus.channel), hint="is the power on?")

    def _disconnect(self) -> None:
        self._opened.close()

    def streams(self) -> tuple[StreamLayout, ...]:
        self._require_open("list its streams")
        channels = tuple(ChannelLayout(quantity, self._joints) for quantity in ("position", "velocity"))
        return (StreamLayout("joints", channels, self._settings.rate),)

    def start(self) -> None:
        require_state(self._state, "open", "start")
        self._receiver.take()  # what came before it was asked
        self._begin()
        self._state = "running"

    def read(self, timeout: float) -> Sequence[Batch]:
        require_state(self._state, "running", "read")
        batches = [batch for frame in self._receiver.take(timeout) for batch in self._take(*frame)]
        if self._clock.now() - self._heard > SILENT:
            raise ConnectionLostError(f"no sample for {SILENT:g} s", where=str(self._settings.channel))
        return batches

    def notices(self) -> Sequence[Notice]:
        return [*super().notices(), *(self._receiver.notices() if self._state != "closed" else ())]

    def command_rate(self) -> float:
        return self._settings.rate

    def take_control(self) -> None:
        self._require_running()
        self._sender.send(MODE, FOLLOW)
        self._controls = True

    def command(self, position: FloatArray) -> None:
        self._require_running()
        target = finite_position(position, self._joints)
        if not self._moved:
            check_first_step(target, self._newest, self._joints)
        if not self._controls:
            self.take_control()
        self._sender.send_all([(TARGET + j, struct.pack("<i", round(1e4 * q))) for j, q in enumerate(target)])
        self._moved = True

    def stop(self) -> None:
        if self._controls:
            with suppress(ConnectionLostError):
                self._sender.send(MODE, HOLD)
        self._controls = self._moved = False
        if self._state == "running":
            self._state = "open"

    def _begin(self) -> None:
        self._row: dict[int, tuple[float, float]] = {}
        self._number = self._last = self._index = -1
        self._newest: FloatArray | None = None
        self._heard = self._clock.now()

    def _take(self, arrived: float, identifier: int, data: bytes) -> list[Batch]:
        """A row, once every joint of a period has come."""
        if len(data) != FRAME.size or not 0 <= identifier - SAMPLE < len(self._joints):
            return []
        position, velocity, number = FRAME.unpack(data)
        if number != self._number:
            self._number, self._row = number, {}
        self._row[identifier - SAMPLE] = (1e-4 * position, 1e-3 * velocity)
        if len(self._row) < len(self._joints):
            return []
        step = (number - self._last) % 0x10000 if self._last >= 0 else 1
        if step > 10.0 * self._settings.rate:  # such a gap would have been a silence
            self._tell("warning", "the drives count anew: were they switched off?")
            step = 1
        self._last, self._index, self._heard = number, self._index + step, arrived
        row = np.array([self._row[joint] for joint in range(len(self._joints))])
        self._row, self._newest = {}, row[:, 0]
        values = {"position": row[np.newaxis, :, 0], "velocity": row[np.newaxis, :, 1]}
        return [Batch("joints", np.array([self._index / self._settings.rate]), np.array([arrived]), values, step - 1)]


def budget(settings: DriverSettings) -> Budget:
    bus, n = read_settings(ToyBusSettings, settings.connection, "toy_bus"), len(settings.joints)
    return Budget(bus.bitrate, bus.rate, (can_frames("samples", n, 8), can_frames("targets", n, 4)), worst=WORST)
