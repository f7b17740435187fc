"""Common base of simulated devices on a python-can bus: opening and closing it, errors, and frames of faults."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Protocol

import can
import numpy as np

from daq.robot.schema import Robot
from drivers.can.bus import close_bus, open_bus
from drivers.core.clock import Clock, set_timer_slack
from drivers.core.errors import ConnectionLostError, UsageError
from sim_drivers.can.bus_load import Frame
from sim_drivers.faults import FAULTS, FaultEntry, ServerKind
from sim_drivers.served import SimOptions
from sim_drivers.server import FaultyServer, Server, stated_keys

BUS_OFF_ERROR = 0x40
"""Identifier of the error frame, as socketcan gives it."""


class BusSettings(Protocol):
    """Where a bus is, as python-can names it."""

    @property
    def interface(self) -> str: ...  # noqa: D102
    @property
    def channel(self) -> str | int: ...  # noqa: D102
    @property
    def bitrate(self) -> int: ...  # noqa: D102
    @property
    def options(self) -> Mapping[str, object]: ...  # noqa: D102


class BusServer(FaultyServer):
    """A device on a bus that `start` opens.

    Args:
        kind: decides which faults it obeys.
        joints: their names, in order.
        bus: its bus.
        clock: the host's.
        beside: servers that start and stop with this one.
        faults: the table that has its faults.
    """

    def __init__(
        self,
        kind: ServerKind,
        joints: Sequence[str],
        bus: BusSettings,
        clock: Clock,
        beside: Sequence[Server] = (),
        faults: Sequence[FaultEntry] = FAULTS,
    ) -> None:
        super().__init__(kind, joints, clock, beside, faults)
        self._bus_settings = bus
        self._bus: can.BusABC | None = None
        self._generator = np.random.default_rng(0)

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

    def _random_frame(self) -> Frame:
        content = self._generator.bytes(int(self._generator.integers(0, 9)))
        return Frame(int(self._generator.integers(1, 0x800)), content)


def send_error_frame(bus: can.BusABC) -> None:
    """The error frame of a controller that goes bus-off."""
    bus.send(can.Message(arbitration_id=BUS_OFF_ERROR, is_error_frame=True, dlc=8, data=bytes(8)))


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
