"""Further processes that search: they end at the deadline, with their parent, and with the search, however it ends."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from types import TracebackType

from drivers.core.child_process import started_without_interrupt
from drivers.core.clock import SYSTEM_CLOCK
from drivers.core.errors import DynidError
from ident.excite.choices import Solver
from ident.excite.search.poses import NoFeasiblePoseError
from ident.excite.search.problem import DesignProblem
from ident.excite.search.start import Report, random_start, run_start

_AHEAD = 2
"""Starts that each process has been given: the one that it runs, and the next."""
_JOINING = 1.0
"""Seconds after which a process that does not end on SIGTERM is killed."""


class TimeIsUpError(Exception):
    """The search's time is over."""


class SearchProcesses:
    """Processes that run one start after another and report the results; a context manager.

    They hang on pipes only. Semaphores in shared memory outlive a process that SIGTERM ends, and Python tells so.

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
        self._starts = starts
        self._next = 1  # start 0 belongs to this process
        end = None if seconds is None else SYSTEM_CLOCK.now() + seconds
        # spawn: a forked child would inherit the threads' locks of whatever this process has been doing.
        context = multiprocessing.get_context("spawn")
        self._processes: list[BaseProcess] = []
        self._pipes: list[Connection] = []
        with started_without_interrupt():
            for _ in range(count):
                pipe, far_end = context.Pipe()
                process = context.Process(target=_work, args=(far_end, seed, solver, end), daemon=True)
                process.start()
                far_end.close()
                self._processes.append(process)
                self._pipes.append(pipe)
        for pipe in self._pipes:
            with suppress(OSError):  # it has died already
                pipe.send(make)
        for _ in range(_AHEAD):
            for pipe in self._pipes:
                self._give_start(pipe)

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
        for pipe in self._pipes:
            pipe.close()

    def next_start(self) -> int | None:
        """The next start that has not begun; None where all have."""
        start = self._next
        if self._starts is not None and start >= self._starts:
            return None
        self._next += 1
        return start

    @property
    def running(self) -> int:
        """Processes that still search."""
        return sum(process.is_alive() for process in self._processes)

    def reports(self, timeout: float = 0.0) -> Iterator[Report]:
        """Their new reports; waits for the first one, at most `timeout` [s].

        Raises:
            DynidError: from building the problem in one of them.
        """
        # Other processes run by the computer's clock, whatever ours is.
        while ready := wait(self._pipes, timeout):
            timeout = 0.0
            for pipe in [pipe for pipe in self._pipes if pipe in ready]:
                try:
                    report = pipe.recv()
                except (EOFError, OSError):
                    self._pipes.remove(pipe)
                    pipe.close()
                    continue
                if report is None:
                    self._give_start(pipe)
                elif isinstance(report, DynidError):
                    raise report
                else:
                    yield report
        self.died = sum(process.exitcode not in (None, 0) for process in self._processes)

    def _give_start(self, pipe: Connection) -> None:
        """Give a process its next start; None where there is none."""
        with suppress(OSError):  # it has died
            pipe.send(self.next_start())


def _work(pipe: Connection, seed: int, solver: Solver, end: float | None) -> None:
    # Ctrl-C reaches the whole process group; the parent decides.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()

    def tick() -> None:
        if end is not None and SYSTEM_CLOCK.now() >= end:
            raise TimeIsUpError
        if parent is not None and not parent.is_alive():
            raise TimeIsUpError

    with suppress(TimeIsUpError, EOFError, ConnectionError):  # of the pipe: the parent is gone
        try:
            problem = pipe.recv()()
            while (start := pipe.recv()) is not None:
                with suppress(NoFeasiblePoseError):
                    begin = random_start(problem, [seed, start], tick=tick)
                    run_start(problem, start, begin, [seed, start], solver, pipe.send, tick)
                pipe.send(None)
        except DynidError as error:
            pipe.send(error)
