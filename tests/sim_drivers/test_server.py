"""The life cycle that all simulated devices share."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import pytest
from simulated_clock import SimulatedClock

from drivers.core.errors import ConnectionFailedError
from sim_drivers.server import Server


class Device(Server):
    """Two threads that count until they stop; one fails after `fails_after` [s]."""

    def __init__(self, clock: SimulatedClock, *beside: Server, fails_after: float = 1e9, openable: bool = True) -> None:
        super().__init__(clock, beside)
        self.log: list[str] = []
        self._fails_after, self._openable = fails_after, openable

    def _open(self) -> None:
        self.log.append("open")
        if not self._openable:
            raise ConnectionFailedError("no port")

    def _close(self) -> None:
        self.log.append("close")

    def _work(self) -> Mapping[str, Callable[[], None]]:
        return {"one": self._wait, "two": self._fail}

    def _wait(self) -> None:
        self._stopping.wait(1e9)
        self.log.append("one")

    def _fail(self) -> None:
        if not self._stopping.wait(self._fails_after):
            raise ValueError("broken")
        self.log.append("two")


def test_it_opens_works_and_closes_once_and_starts_only_once(clock: SimulatedClock) -> None:
    with Device(clock) as device:
        clock.sleep(1.0)
        assert device.log == ["open"]
        with pytest.raises(RuntimeError, match="started already"):
            device.start()
    assert device.log == ["open", "one", "two", "close"]
    device.stop()
    assert device.log.count("close") == 1
    assert device.failure is None


def test_a_failure_ends_all_threads_closes_and_is_kept_here_and_beside(clock: SimulatedClock) -> None:
    broken = Device(clock, fails_after=0.5)
    with Device(clock, broken) as device:
        clock.sleep(1.0)
        assert broken.log == ["open", "one", "close"]
        assert isinstance(broken.failure, ValueError)
        assert device.failure is broken.failure
    assert device.log == ["open", "one", "two", "close"]


def test_what_was_opened_is_closed_when_a_start_fails(clock: SimulatedClock) -> None:
    first, second = Device(clock), Device(clock, openable=False)
    device = Device(clock, first, second)
    with pytest.raises(ConnectionFailedError):
        device.start()
    for each in (device, first, second):
        assert each.log[0] == "open"
        assert each.log[-1] == "close"
    assert clock.end() == []


def test_it_closes_without_having_started(clock: SimulatedClock) -> None:
    device = Device(clock)
    device.stop()
    assert device.log == ["close"]
