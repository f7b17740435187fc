"""The clock of the tests keeps its own promises: exact times, one order of events, no thread forgotten."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable

import can
import numpy as np
import pytest
from simulated_clock import START, SimulatedClock, simulated_time

from drivers.can.bus import Sender, open_bus
from drivers.can.receiver import Receiver


def test_time_passes_only_by_waiting_and_then_exactly() -> None:
    with simulated_time() as clock:
        assert clock.now() == START
        clock.sleep(3600.0)
        assert clock.now() == START + 3600.0
        assert clock.sleep_until(START + 7200.0) == 0.0
        clock.stall(0.5)
        assert clock.sleep_until(START + 7200.0) == 0.5


def test_threads_run_in_the_order_of_their_times() -> None:
    said: list[tuple[float, str]] = []

    def speak(name: str, period: float, clock: SimulatedClock) -> None:
        for _ in range(3):
            clock.sleep(period)
            said.append((clock.now() - START, name))

    with simulated_time() as clock:
        threads = [clock.thread(speak, name, (name, period, clock)) for name, period in (("a", 2.0), ("b", 3.0))]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert not any(thread.is_alive() for thread in threads)
    assert said == [(2.0, "a"), (3.0, "b"), (4.0, "a"), (6.0, "b"), (6.0, "a"), (9.0, "b")]


def test_suspended_threads_go_on_later_and_the_others_run_meanwhile() -> None:
    said: list[tuple[float, str]] = []

    def speak(name: str, clock: SimulatedClock) -> None:
        for _ in range(4):
            clock.sleep(1.0)
            said.append((clock.now() - START, name))

    with simulated_time() as clock:
        threads = [clock.thread(speak, name, (name, clock)) for name in "ab"]
        for thread in threads:
            thread.start()
        event = clock.event()
        waiting = clock.thread(lambda: said.append((event.wait() and clock.now() - START, "c")), "c")
        waiting.start()
        clock.call_at(START + 1.5, lambda: clock.suspend(1.7, but=("b",)))
        clock.call_at(START + 2.0, event.set)
        for thread in (*threads, waiting):
            thread.join()
    assert said == [(1, "a"), (1, "b"), (2, "b"), (3, "b"), *said[4:]]
    assert said[4][0] == said[5][0] == pytest.approx(3.2)
    assert {said[4][1], said[5][1]} == {"a", "c"}
    np.testing.assert_allclose([time for time, _ in said[6:]], [4.0, 4.2, 5.2])


def test_events_conditions_locks_and_joins_wait_in_simulated_time() -> None:
    with simulated_time() as clock:
        event, condition, lock = clock.event(), clock.condition(), clock.lock()
        assert not event.wait(1.5)
        assert clock.now() == START + 1.5
        clock.call_at(START + 2.0, event.set)
        assert event.wait(10.0)
        assert clock.now() == START + 2.0

        found: list[int] = []

        def put() -> None:
            with condition:
                found.append(1)
                condition.notify()

        clock.call_at(START + 3.0, put)
        with condition:
            assert condition.wait_for(lambda: found, 5.0)
        assert clock.now() == START + 3.0
        with condition:
            assert not condition.wait_for(lambda: len(found) > 1, 5.0)
        assert clock.now() == START + 8.0

        def hold() -> None:
            with lock:
                clock.sleep(4.0)

        holder = clock.thread(hold, "holder")
        holder.start()
        holder.join(1.0)
        assert holder.is_alive()
        with lock:
            assert clock.now() == START + 12.0


def test_sockets_are_waited_for_in_simulated_time() -> None:
    near, far = socket.socketpair()
    with near, far, simulated_time() as clock:
        clock.call_at(START + 1.0, lambda: far.send(b"x"))
        assert clock.select([near], [], 0.5) == ([], [])
        assert clock.select([near], [], 5.0) == ([near], [])
        assert clock.now() == START + 1.0


def test_frames_of_the_virtual_bus_bear_the_time_of_the_clock() -> None:
    with simulated_time() as clock:
        near, far = (open_bus("virtual", "simulated", 1_000_000, {}) for _ in range(2))
        receiver = Receiver(near, clock=clock)
        receiver.start()
        clock.call_at(START + 0.123, lambda: Sender(far, clock).send(0x123, b"data"))
        (frame,) = receiver.take(1.0)
        assert frame == (pytest.approx(START + 0.123, abs=1e-6), 0x123, b"data")
        assert clock.now() == START + 0.123
        receiver.stop()
        near.shutdown()
        far.shutdown()
    assert isinstance(can.Bus("quiet", "virtual", ignore_config=True), can.interfaces.virtual.VirtualBus)


def waits_for_ever(clock: SimulatedClock) -> None:
    clock.thread(clock.event().wait, "idle").start()
    clock.event().wait()


def turns_in_circles(clock: SimulatedClock) -> None:
    while True:
        clock.wait(lambda: True, 0.0)


def leaves_a_thread(clock: SimulatedClock) -> None:
    clock.thread(clock.sleep, "idle", (1e9,)).start()


def breaks_in_a_thread(clock: SimulatedClock) -> None:
    thread = clock.thread({}.__getitem__, "broken", ("key",))
    thread.start()
    thread.join()


@pytest.mark.parametrize(
    ("act", "error", "words"),
    [
        (waits_for_ever, RuntimeError, "never comes: idle, the test"),
        (turns_in_circles, RuntimeError, "time does not go on"),
        (leaves_a_thread, AssertionError, "threads left running: idle"),
        (breaks_in_a_thread, KeyError, "key"),
    ],
)
def test_what_would_hang_or_be_overlooked_is_an_error(
    act: Callable[[SimulatedClock], None], error: type[Exception], words: str
) -> None:
    with pytest.raises(error, match=words), simulated_time() as clock:
        act(clock)


def test_a_thread_that_takes_no_part_is_refused() -> None:
    with simulated_time() as clock:
        refused: list[BaseException] = []

        def wait() -> None:
            try:
                clock.sleep(1.0)
            except RuntimeError as error:
                refused.append(error)

        thread = threading.Thread(target=wait)
        thread.start()
        thread.join()
        assert "takes no part" in str(refused[0])
