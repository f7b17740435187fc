"""Common base of simulated devices on a python-can bus: opening and closing it, errors, and frames of faults."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import replace

import can
import numpy as np

from daq.robot.schema import Robot
from drivers.can.bus import close_bus, open_bus
from drivers.can.settings import CanSettings
from drivers.core.clock import Clock, set_timer_slack
from drivers.core.errors import ConnectionLostError, UsageError
from sim_drivers.can.bus_load import Frame
from sim_drivers.faults import FAULTS, Fault, FaultEntry, ServerKind
from sim_drivers.served import SimOptions
from sim_drivers.server import FaultyServer, Server, stated_keys

BUS_OFF_ERROR = 0x40
"""Identifier of the error frame, as socketcan gives it."""
NO_FRAME = 0.005
"""[s] that a server waits after something on the bus that is no frame."""


class BusServer(FaultyServer):
    """A device on a bus that `start` opens."""

    def __init__(
        self,
        kind: ServerKind,
        joints: Sequence[str],
        bus: CanSettings,
        clock: Clock,
        beside: Sequence[Server] = (),
        faults: Sequence[FaultEntry] = FAULTS,
    ) -> None:
        super().__init__(kind, joints, clock, beside, faults)
        self._bus_settings = bus
        self._bus: can.BusABC | None = None
        self._generator = np.random.default_rng(0)
        self._drop = self._truncate = 0
        self._silent_until = self._deaf_until = -math.inf

    def ready(self) -> dict[str, object]:
        """Address for clients."""
        bus = self._bus_settings
        return {"interface": bus.interface, "channel": bus.channel, "bitrate": bus.bitrate}

    def _open(self) -> None:
        settings = self._bus_settings
        self._bus = open_bus(settings.interface, settings.channel, settings.bitrate, settings.options)

    def _close(self) -> None:
        bus, self._bus = self._bus, None
        if bus is not None:
            close_bus(bus)

    def _run_on_bus(self) -> None:
        assert self._bus is not None
        set_timer_slack()
        try:
            self._serve(self._bus)
        except can.CanError as error:
            raise ConnectionLostError(f"the bus does not accept frames: {error.__cause__ or error}") from error

    @abstractmethod
    def _serve(self, bus: can.BusABC) -> None:
        """Exchange frames until `_stopping` is set."""

    def _received(self, bus: can.BusABC, timeout: float) -> can.Message | None:
        """The next message; None where none comes within `timeout` [s], or what came is no frame."""
        try:
            return bus.recv(timeout)
        except (can.CanOperationError, ValueError, IndexError, TypeError):
            # A bus that is gone shows when something is sent.
            self._stopping.wait(NO_FRAME)
            return None

    def _cause(self, bus: can.BusABC, fault: Fault, now: float) -> None:
        """Faults that devices on every bus have; [s, host's clock]."""
        match fault:
            case Fault("drop", (count,)):
                self._drop += count
            case Fault("truncate", (count,)):
                self._truncate += count
            case Fault("freeze", (duration,)):
                self._silent_until = now + duration
            case Fault("bus-off", (duration,)):
                bus.send(can.Message(arbitration_id=BUS_OFF_ERROR, is_error_frame=True, dlc=8, data=bytes(8)))
                self._silent_until = self._deaf_until = now + duration
            case Fault("garbage", (count,)):
                for _ in range(count):
                    self._spread(bus, self._random_frame(), now)
            case _:
                self._not_caused(fault)

    def _spread(self, bus: can.BusABC, frame: Frame, now: float) -> None:
        """Send a frame that is no device's."""
        bus.send(message_of(frame))

    def _spoilt(self, frame: Frame) -> Frame | None:
        """A frame that is to be sent, as the faults leave it; None where they keep it back."""
        if self._drop or self._clock.now() < self._silent_until:
            self._drop = max(0, self._drop - 1)
            return None
        if self._truncate and frame.data:
            self._truncate -= 1
            return replace(frame, data=frame.data[:-1])
        return frame

    def _random_frame(self) -> Frame:
        content = self._generator.bytes(int(self._generator.integers(0, 9)))
        return Frame(int(self._generator.integers(1, 0x800)), content)


def message_of(frame: Frame, *, fd: bool = False) -> can.Message:
    """A frame as python-can sends it; `fd`: one of CAN FD."""
    return can.Message(
        arbitration_id=frame.id,
        is_extended_id=frame.extended,
        is_remote_frame=frame.remote,
        dlc=len(frame.data),
        data=frame.data,
        is_fd=fd,
        bitrate_switch=fd,
        check=False,
    )


def frame_of(message: can.Message, most: int = 8) -> Frame | None:
    """A message as the bus model takes it; None where it is an error frame, cut short, or of more than `most` bytes."""
    content = bytes(message.dlc) if message.is_remote_frame else bytes(message.data)
    if message.is_error_frame or message.dlc != len(content) or len(content) > most:
        return None
    return Frame(message.arbitration_id, content, message.is_extended_id, message.is_remote_frame)


def table_keys(robot: Robot, driver: str, options: SimOptions, lacks: str, page: str) -> dict[str, object]:
    """The keys of the first connection with a driver, with the options in their place; errors as `stated_keys`."""
    if options.swap is not None or options.worst_stuffing:
        raise UsageError("--swap and --worst-stuffing are for --wire canopen and slcan")
    return with_options(stated_keys(robot, driver, lacks, page), options)


def with_options(keys: dict[str, object], options: SimOptions) -> dict[str, object]:
    """The keys with the interface and the channel that were asked for."""
    if options.interface is not None and options.interface != keys.get("interface"):
        keys |= {"interface": options.interface, "options": {}}
    if options.channel is not None:
        keys["channel"] = options.channel
    return keys
