"""Temperatures that drives keep in an object of their own: asked for by SDO, drive after drive, beside the samples."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.base import Notice, drained
from drivers.canopen402.protocol.objects import DriveObject
from drivers.canopen402.protocol.sdo import RemoteDrive
from drivers.canopen402.settings import TemperatureSource
from drivers.core.arrays import FloatArray
from drivers.core.clock import SYSTEM_CLOCK, BackgroundWork, Clock
from drivers.core.errors import ConnectionFailedError, ConnectionLostError

RATE = 5.0
"""Rows a second."""
NOTICE_PERIOD = 10.0
"""At most one notice a joint in so many seconds."""
_LONGEST_NAME = 8


@dataclass(frozen=True)
class TemperatureReading:
    """Temperatures of one round."""

    host_time: float  # of the last answer [s, host's monotonic clock]
    values: FloatArray  # (m,) [°C]; nan where a drive did not answer


class TemperaturePoll(BackgroundWork):
    """Asks drives for their temperature in a thread of its own."""

    def __init__(
        self, drives: Sequence[RemoteDrive], sources: Sequence[TemperatureSource], clock: Clock = SYSTEM_CLOCK
    ) -> None:
        super().__init__("temperatures", clock)
        self._drives = tuple(drives)
        self._sources = tuple(sources)
        self._readings: deque[TemperatureReading] = deque()
        self._notices: deque[Notice] = deque()
        self._reported: dict[str, float] = {}

    def start(self) -> None:
        """Begin to ask."""
        self._readings.clear()
        super().start()

    def finish(self) -> None:
        """Ask no more, without waiting for an answer that is still to come; safe at any time."""
        self._ending.set()

    def take(self) -> list[TemperatureReading]:
        """Readings since the last call."""
        return drained(self._readings)

    def notices(self) -> list[Notice]:
        """Notices since the last call."""
        return drained(self._notices)

    def _run(self) -> None:
        begin, turn, step = self._clock.now(), 0, 1.0 / (RATE * len(self._drives))
        while True:
            values = np.full(len(self._drives), math.nan)
            for index, (drive, source) in enumerate(zip(self._drives, self._sources, strict=True)):
                turn += 1
                if self._ending.wait(max(0.0, begin + turn * step - self._clock.now())):
                    return
                try:
                    values[index] = read_temperature(drive, source)
                except (ConnectionFailedError, ConnectionLostError) as error:  # an adapter may take the next request
                    self._report(drive, str(error))
            self._readings.append(TemperatureReading(self._clock.now(), values))
            turn = max(turn, math.floor((self._clock.now() - begin) / step))

    def _report(self, drive: RemoteDrive, message: str) -> None:
        now = self._clock.now()
        if now - self._reported.get(drive.joint, -math.inf) >= NOTICE_PERIOD:
            self._reported[drive.joint] = now
            self._notices.append(Notice(math.nan, "warning", f"no temperature: {message}"))


def read_temperature(drive: RemoteDrive, source: TemperatureSource) -> float:
    """A drive's temperature now [°C].

    Raises:
        ConnectionFailedError: no answer, or refused.
    """
    entry = DriveObject(source.index, source.subindex, _LONGEST_NAME, source.signed, "temperature")
    data = drive.read_bytes(entry)
    return int.from_bytes(data, "little", signed=source.signed) * source.scale + source.offset
