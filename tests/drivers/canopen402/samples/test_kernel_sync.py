"""SYNC that the kernel sends: a virtual bus whose periodic task runs beside the process, in simulated time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import can
import numpy as np
import pytest
from can.interfaces.virtual import VirtualBus
from canopen_bench import RATE, Bench, bench

from drivers.canopen402.samples.sync import PATIENCE
from drivers.core.clock import Clock
from drivers.core.errors import ConnectionLostError

DRIVES, KERNEL = "scripted drives", "kernel"


class KernelTask:
    """Sends a frame on an absolute schedule, so that everybody on the bus hears it, the sender as well."""

    def __init__(self, channel: str, message: can.Message, period: float, clock: Clock) -> None:
        self._bus = can.Bus(interface="virtual", channel=channel, ignore_config=True)
        self._message, self._period, self._clock = message, period, clock
        self._ending = clock.event()
        self._thread = clock.thread(self._run, KERNEL)
        self._thread.start()

    def stop(self) -> None:
        self._ending.set()
        self._thread.join()
        self._bus.shutdown()

    def _run(self) -> None:
        due = self._clock.now() + 0.3 * self._period
        while not self._ending.is_set():
            self._clock.sleep_until(due)
            if not self._ending.is_set():
                self._bus.send(self._message)
            due += self._period


@contextmanager
def kernel_bench(monkeypatch: pytest.MonkeyPatch, *, sends: bool = True, **keys: object) -> Iterator[Bench]:
    tasks: list[KernelTask] = []
    monkeypatch.setattr("drivers.canopen402.driver.sends_in_kernel", lambda bus: True)
    with bench(begin="open", **keys) as one:

        def send_periodic(bus: VirtualBus, message: can.Message, period: float) -> KernelTask:
            assert message.arbitration_id == 0x80
            assert not message.data
            tasks.append(KernelTask(one.bus.channel if sends else "elsewhere", message, period, one.clock))
            return tasks[-1]

        monkeypatch.setattr(VirtualBus, "send_periodic", send_periodic)
        one.driver.start()
        yield one
        one.driver.stop()
    assert len(tasks) == 1
    assert not tasks[0]._thread.is_alive()


def test_rows_have_the_kernels_moments(monkeypatch: pytest.MonkeyPatch) -> None:
    with kernel_bench(monkeypatch) as one:
        one.read_rows(50)
        first = one.slots[0]
        assert one.slots == list(range(first, first + 50))
        assert one.lost == 0
        np.testing.assert_allclose(one.joined("sync_lateness"), 0.0, atol=1e-6)
        assert [identifier for identifier, _ in one.bus.seen].count(0x80) == 51


@pytest.mark.parametrize("suspended", [0.03, 0.4])
def test_a_process_that_is_held_up_loses_nothing(monkeypatch: pytest.MonkeyPatch, suspended: float) -> None:
    with kernel_bench(monkeypatch) as one:
        one.read_rows(10)
        one.clock.suspend(suspended, but=(DRIVES, KERNEL))
        one.clock.sleep(0.001)
        one.read_rows(50)
        assert one.slots == list(range(one.slots[0], one.slots[-1] + 1))
        assert one.lost == 0
        assert one.driver.losses("joints") == ""


def test_drives_are_moved_and_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    with kernel_bench(monkeypatch) as one:
        one.enable()
        goal = one.position + 0.01
        for _ in range(5):
            one.driver.command(goal)
            one.read_rows(1)
        one.read_rows(5)
        np.testing.assert_allclose(one.position, goal, atol=1e-4)
        syncs = [time for (identifier, _), time in zip(one.bus.seen, one.bus.times, strict=True) if identifier == 0x80]
        targets = [
            time for (identifier, _), time in zip(one.bus.seen, one.bus.times, strict=True) if identifier >> 7 == 4
        ]
        behind = [time - max(sync for sync in syncs if sync <= time) for time in targets]
        assert max(behind) < 0.5 / RATE  # each with its SYNC
        one.driver.stop()
        assert [drive.state for drive in one.drives] == ["disabled"] * 3


def test_a_kernel_that_cannot_leaves_it_to_a_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(bus: VirtualBus, message: can.Message, period: float) -> None:
        raise OSError(93, "Protocol not supported")

    monkeypatch.setattr("drivers.canopen402.driver.sends_in_kernel", lambda bus: True)
    monkeypatch.setattr(VirtualBus, "send_periodic", refuse)
    with bench() as one:
        one.read_rows(50)
        assert one.slots == list(range(1, 51))
        assert one.lost == 0


def test_an_adapter_that_sends_nothing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    with kernel_bench(monkeypatch, sends=False) as one:
        begun = one.clock.now()
        with pytest.raises(ConnectionLostError, match="the CAN adapter has sent no SYNC"):
            one.read(lambda: False)
        assert PATIENCE < one.clock.now() - begun < 4 * PATIENCE
