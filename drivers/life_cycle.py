"""The states of a driver: how it is opened and closed, and what it refuses in the wrong one, whatever its bus."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Sequence

from drivers.base import DriverSettings, Level, Notice, State, drained, require_state
from drivers.core.errors import ConnectionFailedError, ConnectionLostError, DriverStateError


class LifeCycle(ABC):
    """Implements `open`, `notices` and `close` of `drivers.base.Driver` on `_connect`, `_disconnect` and `stop`."""

    def __init__(self, settings: DriverSettings) -> None:
        self._joints, self._sliding, self._clock = settings.joints, settings.sliding, settings.clock
        self._state: State = "closed"
        self._halted = False
        self._notices: deque[Notice] = deque()

    @abstractmethod
    def _connect(self) -> None:
        """Open the connection, and check the other side."""

    @abstractmethod
    def _disconnect(self) -> None:
        """Let go of the connection; safe at any time."""

    def _take_leave(self) -> None:  # noqa: B027
        """Tell the other side, where it is still connected, before the connection is let go; never raises."""

    @abstractmethod
    def stop(self) -> None:
        """Halt the arm where this driver moves it, then end the samples; safe in every state, never raises."""

    def open(self) -> None:
        """Open the connection and check the other side, within a time limit."""
        require_state(self._state, "closed", "open")
        try:
            self._connect()
        except ConnectionLostError as error:
            self._disconnect()
            raise ConnectionFailedError(error.message, where=error.where, hint=error.hint) from error
        except BaseException:
            self._disconnect()
            raise
        self._state = "open"

    def notices(self) -> Sequence[Notice]:
        """Return what was reported since the last call."""
        return drained(self._notices)

    def close(self) -> None:
        """Let go of the connection; safe in every state."""
        self.stop()
        self._take_leave()
        self._disconnect()
        self._state = "closed"

    def _require_open(self, action: str) -> None:
        if self._state == "closed":
            require_state(self._state, "open", action)

    def _require_running(self) -> None:
        """Refuse a motion unless samples flow and no stop is in progress."""
        require_state(self._state, "running", "move")
        if self._halted:
            raise DriverStateError("the arm is being stopped", hint="start again before the next motion")

    def _tell(self, level: Level, message: str, hint: str = "", time: float = math.nan) -> None:
        self._notices.append(Notice(time, level, message, hint))
