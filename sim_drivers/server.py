"""The life cycle of simulated devices: they start, work in threads of a clock, and stop."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING, NoReturn, Self

from daq.robot.schema import Robot
from daq.session.connections import keys_of_driver
from drivers.base import drained
from drivers.core.clock import Clock
from drivers.core.errors import UsageError
from sim_drivers.faults import FAULTS, Fault, FaultEntry, ServerKind, parse_fault

if TYPE_CHECKING:
    import threading

LONGEST_LAG = 0.25
"""A stall of more than this [s] is not made up for: the arm's time is halted meanwhile."""

STOP_TIMEOUT = 5.0
"""[s] that a stop waits for each thread."""


class Server(ABC):
    """A simulated device; `start` and `stop`, or its context, begin and end it. It starts once.

    Servers `beside` start and stop with this one; the end of one ends this one.
    """

    def __init__(self, clock: Clock, beside: Sequence[Server] = ()) -> None:
        self._clock = clock
        self._beside = tuple(beside)
        self._stopping = clock.event()
        self._threads: list[threading.Thread] = []
        self._counting = clock.lock()
        self._running = 0
        self._failure: BaseException | None = None

    @property
    def failure(self) -> BaseException | None:
        """The error that ended it; None while it runs and after `stop`."""
        return next((error for error in (self._failure, *(thread.failure for thread in self._beside)) if error), None)

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self) -> None:
        """Open its resources and start its threads.

        Raises:
            ConnectionFailedError: a port, bus or address is not available.
        """
        if self._threads:
            raise RuntimeError("started already")
        with ExitStack() as undo:
            undo.callback(self._close)
            self._open()
            for server in self._beside:
                server.start()
                undo.callback(server.stop)
            undo.pop_all()
        work = self._work()
        self._running = len(work)
        self._threads = [self._clock.thread(self._run, name, (task,)) for name, task in work.items()]
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        """End the threads and close everything; safe to call twice."""
        self._stopping.set()
        self._wake()
        for thread in self._threads:
            thread.join(STOP_TIMEOUT)
        if not self._threads:
            self._close()
        for server in self._beside:
            server.stop()

    def _run(self, task: Callable[[], None]) -> None:
        try:
            task()
        except BaseException as error:  # the thread ends either way; `failure` says why
            self._failure = error
            self._stopping.set()
        finally:
            with self._counting:
                self._running -= 1
                last = self._running == 0
            if last:
                self._close()

    @abstractmethod
    def _work(self) -> Mapping[str, Callable[[], None]]:
        """Functions of its threads until `_stopping` is set, by thread name."""

    def _open(self) -> None:  # noqa: B027
        """Open the threads' resources."""

    def _close(self) -> None:  # noqa: B027
        """Close it: after the last thread, or where none was started; safe to call twice."""

    def _wake(self) -> None:  # noqa: B027
        """Wake threads that wait for something other than `_stopping`."""


class FaultyServer(Server):
    """A server that obeys faults.

    `kind` decides which faults of the table.

    Attributes:
        messages: for the terminal, oldest first.
    """

    def __init__(
        self,
        kind: ServerKind,
        joints: Sequence[str],
        clock: Clock,
        beside: Sequence[Server] = (),
        faults: Sequence[FaultEntry] = FAULTS,
    ) -> None:
        super().__init__(clock, beside)
        self.joints = tuple(joints)
        self.messages: deque[str] = deque(maxlen=100)
        self._kind = kind
        self._known_faults = tuple(faults)
        self._requested: deque[Fault] = deque()

    def cause(self, fault: Fault) -> None:
        """Request a fault; from any thread."""
        self._requested.append(fault)

    def obey(self, line: str) -> None:
        """Request a typed fault."""
        self.cause(parse_fault(line, self._kind, self.joints, self._known_faults))

    def _not_caused(self, fault: Fault) -> NoReturn:
        """Raise at a fault that its table lists and no case causes, which is an error of the server itself."""
        raise AssertionError(f"{self._kind} does not cause its fault '{fault.word}'")

    def _new_faults(self) -> list[Fault]:
        """The faults requested since the last call."""
        return drained(self._requested)


def with_troubles(line: str, **counts: int) -> str:
    """A line about a server's state, and what went wrong how often."""
    return line + "".join(f", {count} {word.replace('_', ' ')}" for word, count in counts.items() if count)


def stated_keys(robot: Robot, driver: str, lacks: str, page: str) -> dict[str, object]:
    """The keys of a robot's first connection with a driver; where there is none, a UsageError with what it lacks."""
    keys = keys_of_driver(robot, driver)
    if keys is None:
        raise UsageError(
            f"the robot file has no connection with the driver {driver}, so {lacks}",
            where=f"{robot.name}: connections",
            hint=f"{page} shows one",
        )
    return keys
