"""Simulated time: a clock that advances only when every thread waits, and a virtual CAN bus that waits on it.

Of all threads that take part, one runs at a time. It runs until it waits on the clock; then the one that has waited
longest for something that has become true goes on, or, where there is none, time jumps to the first time limit. So a
test takes as long as its computation, its outcome does not depend on the computer, and it is the same every time.
"""

from __future__ import annotations

import math
import select
import threading
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from copy import copy
from operator import attrgetter
from typing import Any

import can
import can.interfaces
from can.interfaces import virtual

from drivers.core.clock import Clock, HasFileno

START = 1000.0
DAY = 1.75e9
"""Time of day at monotonic time 0."""
TURNS_LIMIT = 200_000
"""Waits without any time in between, after which a loop is taken for endless."""


class _Ended(SystemExit):
    """Ends threads that are left when the test is over."""


class _Waiter:
    """A thread that waits; it goes on when it is handed its baton."""

    __slots__ = ("baton", "deadline", "is_ready", "ready", "thread")

    def __init__(self, ready: Callable[[], object] | None, deadline: float, thread: int | None = None) -> None:
        self.ready = ready
        """None where it waits for time alone, which most do."""
        self.is_ready = False
        """When it was chosen to go on; nothing runs until it does."""
        self.deadline = deadline
        self.thread = thread
        self.baton = threading.Lock()
        self.baton.acquire()


_DEADLINE = attrgetter("deadline")


class SimulatedClock(Clock):
    """Time for a test; the thread that makes it takes part, others do when `thread` made them."""

    def __init__(self) -> None:
        super().__init__()
        self._now = START
        self._waiters: list[_Waiter] = []
        self._test = threading.get_ident()
        self._members = {self._test: "the test"}
        self._turns = 0
        self._held: dict[int | None, float] = {}
        self._failure: str | None = None
        self._ended = False
        self.errors: list[BaseException] = []
        """What ended threads."""

    def now(self) -> float:
        """See `Clock.now`."""
        return self._now

    def time_of_day(self) -> float:
        """See `Clock.time_of_day`."""
        return DAY + self._now

    def sleep(self, seconds: float) -> None:
        """See `Clock.sleep`."""
        if seconds > 0.0:
            moment = self._after(seconds)
            self._wait_until(None, moment)
            self.late(moment)

    def sleep_until(self, moment: float) -> float:
        """See `Clock.sleep_until`."""
        if moment <= self._now:
            return self._now - moment
        self._wait_until(None, moment)
        return self.late(moment)

    def stall(self, seconds: float) -> None:
        """Let time pass while no other thread runs, as on a computer that is busy with another program."""
        self._now += seconds
        self._turns = 0

    def suspend(self, seconds: float, but: Collection[str]) -> None:
        """Let no thread run for so long but those of these names, and new ones, as when their process is stopped."""
        held = [thread for thread, name in self._members.items() if name not in but]
        self._held = dict.fromkeys(held, self._now + seconds)

    def wait(self, ready: Callable[[], object], seconds: float | None = None) -> bool:
        """Let other threads run until something is true or `seconds` have passed; whether it is true.

        It is asked again and again, in other threads: it must neither wait nor change anything.
        """
        return self._wait_until(ready, math.inf if seconds is None else self._after(seconds))

    def _after(self, seconds: float) -> float:
        """Time in so long; later than now where that is not nothing."""
        return self._now if seconds <= 0.0 else max(self._now + seconds, math.nextafter(self._now, math.inf))

    def event(self) -> threading.Event:
        """See `Clock.event`."""
        return _Event(self)

    def condition(self) -> threading.Condition:
        """See `Clock.condition`."""
        return _Condition(self)

    def lock(self) -> _Lock:
        """See `Clock.lock`."""
        return _Lock(self)

    def thread(self, target: Callable[..., object], name: str, args: Sequence[object] = ()) -> threading.Thread:
        """See `Clock.thread`."""
        return _Thread(self, self.watched(target, name), name, tuple(args))

    def call_at(self, moment: float, action: Callable[[], object]) -> threading.Thread:
        """Do something at a time of this clock, in a thread of its own."""

        def act() -> None:
            self.sleep_until(moment)
            action()

        thread = self.thread(act, f"at {moment:g} s")
        thread.start()
        return thread

    def _select(
        self, readers: Sequence[HasFileno], writers: Sequence[HasFileno], seconds: float
    ) -> tuple[list[HasFileno], list[HasFileno]]:
        ready: tuple[list[HasFileno], list[HasFileno], list[HasFileno]] = ([], [], [])

        def look() -> bool:
            nonlocal ready
            try:
                ready = select.select(readers, writers, (), 0.0)
            except (OSError, ValueError):  # closed meanwhile: the error surfaces on the next read
                ready = (list(readers), [], [])
            return bool(ready[0] or ready[1])

        if not look():
            self.wait(look, seconds)
        return ready[0], ready[1]

    def made(self, thread: threading.Thread) -> bool:
        """Return whether a thread is this clock's."""
        return isinstance(thread, _Thread)

    def end(self) -> list[str]:
        """End the threads that are left; their names."""
        self._members.pop(threading.get_ident(), None)
        left = sorted(self._members.values())
        self._ended = True
        for waiter in self._waiters:
            waiter.baton.release()
        self._waiters.clear()
        return left

    def _wait_until(self, ready: Callable[[], object] | None, deadline: float) -> bool:
        thread = threading.get_ident()
        if thread not in self._members:
            raise RuntimeError("a thread waits on a simulated clock that it takes no part in; make it by clock.thread")
        if self._ended:
            raise _Ended
        self._turns += 1
        if self._turns > TURNS_LIMIT:
            self._failure = f"at {self._now:.6f} s time does not go on: some loop waits for no time at all"
        waiter = _Waiter(ready, deadline, thread)
        self._waiters.append(waiter)
        following = self._next()
        if following is not waiter:
            following.baton.release()
            waiter.baton.acquire()
            if self._ended:
                raise _Ended
        if self._failure is not None:
            self._turns = 0
            message, self._failure = self._failure, None
            raise RuntimeError(message)
        return waiter.is_ready or (ready is not None and bool(ready()))

    def _next(self) -> _Waiter:
        """Take who goes on next out of the list, and let time pass until it does."""
        waiter = self._first_ready() if self._failure is None else None
        if waiter is None and self._failure is None:
            limit = self._limit if self._held else _DEADLINE
            waiter = min(self._waiters, key=limit)
            if limit(waiter) < math.inf:
                self._now = max(self._now, limit(waiter))
                self._turns = 0
            else:
                names = ", ".join(sorted(self._members.values()))
                self._failure = f"every thread waits without a time limit for something that never comes: {names}"
        if self._failure is not None:  # the test itself fails by it
            waiter = next(candidate for candidate in self._waiters if candidate.thread == self._test)
        assert waiter is not None
        self._waiters.remove(waiter)
        return waiter

    def _first_ready(self) -> _Waiter | None:
        now, held = self._now, self._held
        for waiter in self._waiters:
            if held and held.get(waiter.thread, -math.inf) > now:
                continue
            if waiter.deadline <= now:
                return waiter
            if waiter.ready is not None and waiter.ready():
                waiter.is_ready = True
                return waiter
        return None

    def _limit(self, waiter: _Waiter) -> float:
        """When a waiter goes on at the latest, or may do so again."""
        until = self._held.get(waiter.thread, -math.inf)
        ready = until > self._now and waiter.ready is not None and waiter.ready()
        return until if ready else max(waiter.deadline, until)

    def _leave(self) -> None:
        del self._members[threading.get_ident()]
        if self._waiters and not self._ended:
            self._next().baton.release()


class _Lock:
    def __init__(self, clock: SimulatedClock) -> None:
        self._clock = clock
        self._held = False

    def acquire(self) -> bool:
        while self._held:
            self._clock.wait(lambda: not self._held)
        self._held = True
        return True

    def release(self) -> None:
        self._held = False

    def __enter__(self) -> bool:
        return self.acquire()

    def __exit__(self, *_: object) -> None:
        self.release()


class _Event(threading.Event):
    def __init__(self, clock: SimulatedClock) -> None:
        super().__init__()
        self._clock = clock

    def wait(self, timeout: float | None = None) -> bool:
        return self.is_set() or self._clock.wait(self.is_set, timeout)


class _Condition(threading.Condition):
    def __init__(self, clock: SimulatedClock) -> None:
        self._clock = clock
        self._own = _Lock(clock)
        self._signals: list[list[bool]] = []

    def __enter__(self) -> bool:
        return self._own.acquire()

    def __exit__(self, *_: object) -> None:
        self._own.release()

    def acquire(self, *_: Any) -> bool:
        return self._own.acquire()

    def release(self) -> None:
        self._own.release()

    def wait(self, timeout: float | None = None) -> bool:
        signal = [False]
        self._signals.append(signal)
        self._own.release()
        try:
            return self._clock.wait(lambda: signal[0], timeout)
        finally:
            if signal in self._signals:
                self._signals = [other for other in self._signals if other is not signal]
            self._own.acquire()

    def wait_for(self, predicate: Callable[[], Any], timeout: float | None = None) -> Any:
        end = math.inf if timeout is None else self._clock.now() + timeout
        while not (result := predicate()) and self._clock.now() < end:
            self.wait(None if timeout is None else end - self._clock.now())
        return result

    def notify(self, n: int = 1) -> None:
        for signal in self._signals[:n]:
            signal[0] = True
        del self._signals[:n]

    def notify_all(self) -> None:
        self.notify(len(self._signals))


class _Thread(threading.Thread):
    def __init__(
        self, clock: SimulatedClock, target: Callable[..., object], name: str, args: tuple[object, ...]
    ) -> None:
        super().__init__(target=target, name=name, args=args, daemon=True)
        self._clock = clock
        self._over = False
        self._turn = _Waiter(lambda: True, clock.now())

    def start(self) -> None:
        super().start()
        assert self.ident is not None
        self._clock._members[self.ident] = self.name
        self._clock._waiters.append(self._turn)

    def run(self) -> None:
        self._turn.baton.acquire()
        if self._clock._ended:
            return
        try:
            super().run()
        except _Ended:
            pass
        except BaseException as error:
            self._clock.errors.append(error)
        finally:
            self._over = True
            self._clock._leave()

    def is_alive(self) -> bool:
        return self.ident is not None and not self._over

    def join(self, timeout: float | None = None) -> None:
        if self.ident is None:
            raise RuntimeError("cannot join thread before it is started")
        if self._clock.wait(lambda: self._over, timeout):
            super().join()


class VirtualBus(virtual.VirtualBus):
    """python-can's virtual bus, waiting on and stamped by the clock of the test that runs."""

    clock: SimulatedClock

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """See `can.BusABC.recv`."""
        self._check_if_open()
        frames = self.queue.queue  # one thread runs at a time: the queue's own locks would guard nothing
        if not frames:
            self.clock.wait(lambda: frames or not self._open, timeout)
            self._check_if_open()
        return frames.popleft() if frames else None

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """See `can.BusABC.send`."""
        self._check_if_open()
        received = copy(msg)
        received.timestamp, received.channel, received.is_rx = self.clock.time_of_day(), self.channel_id, True
        for queue in self.channel:
            if queue is not self.queue:
                queue.queue.append(received)
        if self.receive_own_messages:
            own = copy(received)
            own.is_rx = False
            self.queue.queue.append(own)


@contextmanager
def simulated_time() -> Iterator[SimulatedClock]:
    """A clock for the block; meanwhile the interface `virtual` of python-can waits on it.

    Threads that the block leaves behind are an error, as a program that does not end would be.
    """
    clock = SimulatedClock()
    VirtualBus.clock = clock
    backends = can.interfaces.BACKENDS
    before = backends["virtual"]
    backends["virtual"] = (__name__, "VirtualBus")
    try:
        yield clock
    except BaseException:
        clock.end()
        raise
    finally:
        backends["virtual"] = before
    left = clock.end()
    for breakdown in clock.breakdowns():
        raise breakdown.error
    if clock.errors:
        raise clock.errors[0]
    if left:
        raise AssertionError(f"threads left running: {', '.join(left)}")
