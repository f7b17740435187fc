"""Time, and what threads wait on: an argument of everything that runs beside a bus.

Production code takes `SYSTEM_CLOCK`. A test takes a clock whose time advances only while every thread waits, so that
no stall of the computer can happen in it; therefore nothing that waits calls `time` or `threading` itself.
"""

from __future__ import annotations

import ctypes
import select
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Protocol

STALL_LIMIT = 0.05
"""Longest stall of this computer [s] in a motion; one that is longer ends it."""
LATE = 0.01
"""Lateness of a wait [s] from which on it shows that this process did not run."""
_PR_SET_TIMERSLACK = 29


class HasFileno(Protocol):
    """A socket, or anything else with a file descriptor."""

    def fileno(self) -> int:
        """The descriptor."""


@dataclass(frozen=True)
class Breakdown:
    """The unrequested end of a thread."""

    thread: str  # its name
    error: Exception  # what ended it

    def __str__(self) -> str:
        return f"the thread '{self.thread}' broke: {type(self.error).__name__}: {self.error}"


class Clock:
    """The computer's monotonic clock and the operating system's threads."""

    def __init__(self) -> None:
        self._breakdowns: deque[Breakdown] = deque()
        self._pauses: deque[tuple[float, float]] = deque(maxlen=100)

    def now(self) -> float:
        """Monotonic time [s]."""
        return time.monotonic()

    def time_of_day(self) -> float:
        """Seconds since 1970; may be set while the program runs."""
        return time.time()

    def sleep(self, seconds: float) -> None:
        """Let `seconds` [s] pass; nothing where they are not positive."""
        self.sleep_until(self.now() + seconds)

    def sleep_until(self, moment: float) -> float:
        """Sleep until a monotonic time [s]; how late it became [s]."""
        if (seconds := moment - self.now()) <= 0.0:
            return -seconds
        time.sleep(seconds)
        return self.late(moment)

    def late(self, due: float) -> float:
        """How late [s] a thread goes on that was to go on at `due` [s] at the latest; `stalled` counts it."""
        now = self.now()
        if now - due > LATE:
            self._pauses.append((due, now))
        return max(0.0, now - due)

    def stalled(self, since: float) -> float:
        """How long [s] this process did not run from a time [s] on, as far as its threads' waits ended late."""
        total = 0.0
        for begun, ended in sorted(self._pauses.copy()):
            total += max(0.0, ended - max(begun, since))
            since = max(since, ended)
        return total

    def event(self) -> threading.Event:
        """An event to wait for."""
        return threading.Event()

    def condition(self) -> threading.Condition:
        """A condition to wait for."""
        return threading.Condition()

    def lock(self) -> AbstractContextManager[object]:
        """A lock that may be held while its holder waits; a plain one will do where the holder never waits."""
        return threading.Lock()

    def thread(self, target: Callable[..., object], name: str, args: Sequence[object] = ()) -> threading.Thread:
        """A daemon thread that may wait on this clock; not started yet. What breaks it is one of `breakdowns`."""
        return threading.Thread(target=self.watched(target, name), name=name, args=tuple(args), daemon=True)

    def watched(self, target: Callable[..., object], name: str) -> Callable[..., None]:
        """The work of a thread; an error that it lets through becomes one of `breakdowns`."""

        def work(*args: object) -> None:
            try:
                target(*args)
            except Exception as error:  # whatever it is: who relies on the thread must learn that it is gone
                self._breakdowns.append(Breakdown(name, error))

        return work

    def breakdowns(self) -> list[Breakdown]:
        """Threads of this clock that broke since the last call; a session asks in every cycle, and ends by one."""
        return [self._breakdowns.popleft() for _ in range(len(self._breakdowns))]

    def select(
        self, readers: Sequence[HasFileno], writers: Sequence[HasFileno], seconds: float
    ) -> tuple[list[HasFileno], list[HasFileno]]:
        """Return which of some sockets can be read and written, waiting at most `seconds` [s] for the first."""
        due = self.now() + max(0.0, seconds)
        readable, writable = self._select(readers, writers, max(0.0, seconds))
        self.late(due)
        return readable, writable

    def _select(
        self, readers: Sequence[HasFileno], writers: Sequence[HasFileno], seconds: float
    ) -> tuple[list[HasFileno], list[HasFileno]]:
        readable, writable, _ = select.select(readers, writers, (), seconds)
        return readable, writable


SYSTEM_CLOCK = Clock()
"""The only one outside of tests."""


class BackgroundWork(ABC):
    """Work in a thread of its own, from `start` to `stop`; `name` is the thread's."""

    def __init__(self, name: str, clock: Clock) -> None:
        self._name, self._clock, self._ending = name, clock, clock.event()
        self._thread: threading.Thread | None = None

    @abstractmethod
    def _run(self) -> None:
        """Work until `_ending` is set."""

    def start(self) -> None:
        """Begin."""
        self._ending.clear()
        self._thread = self._clock.thread(self._run, self._name)
        self._thread.start()

    def stop(self) -> None:
        """End; safe at any time."""
        self._ending.set()
        thread, self._thread = self._thread, None
        if thread is not None and thread is not threading.current_thread():
            thread.join()


def set_timer_slack() -> None:
    """Let this thread's sleeps end within a nanosecond instead of 50 µs (Linux only)."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
