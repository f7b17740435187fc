"""The conformance suite as a class of tests, for pytest or any other runner that collects methods called `test_…`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import AbstractContextManager

from sim_drivers.conformance.bench import Bench
from sim_drivers.conformance.points import check_point


class DriverConformance(ABC):
    """Tests of a driver, one a point; a subclass gives the bench.

    Example:
        class TestMyBus(DriverConformance):
            def bench(self):
                return declared_bench(load_robot("my_arm.yaml"), "my_bus")
    """

    @abstractmethod
    def bench(self) -> AbstractContextManager[Bench]:
        """A driver and its simulated device, fresh for each test."""

    def test_life_cycle(self) -> None:
        """States follow the contract, and after `close` everything begins anew."""
        self._check("life_cycle")

    def test_time_stamps(self) -> None:
        """Stamps rise at the announced rate, arrivals are the host's clock, blocks are as announced."""
        self._check("time_stamps")

    def test_gaps(self) -> None:
        """Lost samples are counted, or a notice tells; none is invented."""
        self._check("gaps")

    def test_units_and_signs(self) -> None:
        """Samples are the truth in dynid's units; a command moves the joint that it names."""
        self._check("units_and_signs")

    def test_stop(self) -> None:
        """`stop` is safe in every state and brings a moving arm to rest."""
        self._check("stop")

    def test_silence(self) -> None:
        """Nobody there, or a device that falls silent, is an error of one line."""
        self._check("silence")

    def test_garbage(self) -> None:
        """Nonsense is never a sample, and never an error of Python."""
        self._check("garbage")

    def test_restart(self) -> None:
        """A device that was off does not go unnoticed, and is recorded again."""
        self._check("restart")

    def test_clock(self) -> None:
        """It waits by `DriverSettings.clock` alone."""
        self._check("clock")

    def _check(self, point: str) -> None:
        with self.bench() as bench:
            check_point(point, bench)
