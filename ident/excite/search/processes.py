"""Further processes that search: they end at the deadline, with their parent, and with the search, however it ends."""

from __future__ import annotations

import multiprocessing
import queue
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Any

from drivers.core.clock import SYSTEM_CLOCK
from drivers.core.errors import DynidError
from ident.excite.choices import Solver
from ident.excite.search.poses import NoFeasiblePoseError
from ident.excite.search.problem import DesignProblem
from ident.excite.search.start import Report, random_start, run_start

_JOINING = 1.0
"""Seconds after which a process that does not end on SIGTERM is killed."""


class TimeIsUpError(Exception):
    """The search's time is over."""


class SearchProcesses:
    """Processes that run one start after another and report the results; a context manager.

    Args:
        count: how many; 0 for none.
        make: builds the problem in each; picklable.
        seed: of the starts.
        solver: of the local problems.
        starts: after so many starts they end; None for no end.
        seconds: after which they end by themselves, even without the parent; None for no end.

    Attributes:
        died: processes that crashed or were killed.
    """

    def __init__(
        self,
        count: int,
        make: Callable[[], DesignProblem],
        seed: int,
        solver: Solver,
        starts: int | None,
        seconds: float | None,
    ) -> None:
        """Start them."""
        self.died = 0
        # spawn: a forked child would inherit the threads' locks of whatever this process has been doing.
        context = multiprocessing.get_context("spawn")
        self._starts = starts
        self._next = 1
        self._counter: Any = None
        self._results: Any = None
        self._processes: list[Any] = []
        if not count:
            return
        # Start 0 belongs to this process.
        self._counter = context.Value("q", 1)
        self._results = context.Queue()
        end = None if seconds is None else SYSTEM_CLOCK.now() + seconds
        self._processes = [
            context.Process(
                target=_work, args=(make, seed, solver, starts, end, self._counter, self._results), daemon=True
            )
            for _ in range(count)
        ]
        self._running = set(self._processes)
        with _no_interrupt():
            for process in self._processes:
                process.start()

    def __enter__(self) -> SearchProcesses:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End all of them at once."""
        for process in self._processes:
            process.terminate()
        for process in self._processes:
            process.join(_JOINING)
            if process.is_alive():
                process.kill()
                process.join()

    def next_start(self) -> int | None:
        """The next start that has not begun; None where all have."""
        if self._counter is None:
            start = self._next
            self._next += 1
        else:
            start = _taken(self._counter)
        return start if self._starts is None or start < self._starts else None

    @property
    def running(self) -> int:
        """Processes that still search."""
        return sum(process.is_alive() for process in self._processes)

    def reports(self, timeout: float = 0.0) -> Iterator[Report]:
        """Their new reports; waits for the first one, at most `timeout` [s].

        Raises:
            DynidError: from building the problem in one of them.
        """
        if self._results is None:
            return
        while True:
            try:
                # Other processes run by the computer's clock, whatever ours is.
                report = self._results.get(timeout=timeout) if timeout else self._results.get_nowait()
            except queue.Empty:
                break
            timeout = 0.0
            if isinstance(report, DynidError):
                raise report
            yield report
        self.died = sum(process.exitcode not in (None, 0) for process in self._processes)


@contextmanager
def _no_interrupt() -> Iterator[None]:
    """Hold Ctrl-C back: a child inherits it blocked, so that only the parent is interrupted."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _taken(counter: Any) -> int:
    with counter.get_lock():
        start = int(counter.value)
        counter.value += 1
    return start


def _work(
    make: Callable[[], DesignProblem],
    seed: int,
    solver: Solver,
    starts: int | None,
    end: float | None,
    counter: Any,
    results: Any,
) -> None:
    # Ctrl-C reaches the whole process group; the parent decides.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()

    def tick() -> None:
        if end is not None and SYSTEM_CLOCK.now() >= end:
            raise TimeIsUpError
        if parent is not None and not parent.is_alive():
            raise TimeIsUpError

    try:
        problem = make()
        while True:
            start = _taken(counter)
            if starts is not None and start >= starts:
                return
            try:
                begin = random_start(problem, [seed, start], tick=tick)
                run_start(problem, start, begin, [seed, start], solver, results.put, tick)
            except NoFeasiblePoseError:
                continue
    except TimeIsUpError:
        # No process reads it any more: do not wait for it.
        results.cancel_join_thread()
    except DynidError as error:
        results.put(error)
