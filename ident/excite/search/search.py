"""Multistart search on all cores; it keeps the best candidate so far, however it ends."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from types import TracebackType

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.child_process import started_without_interrupt
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.cluster import cluster_executor
from drivers.core.errors import DynidError, IdentificationError
from ident.excite.choices import SearchOptions, Solver
from ident.excite.search.acceptance import accepted
from ident.excite.search.on_cluster import ClusterStarts, TimeIsUpError
from ident.excite.search.poses import NoFeasiblePoseError
from ident.excite.search.problem import DesignProblem
from ident.excite.search.start import CandidateMotion, Finished, Report, later_starts, no_tick, random_start, run_start

_AHEAD = 2
"""Starts that each process has been given: the one that it runs, and the next."""
_JOINING = 1.0
"""Seconds after which a process that does not end on SIGTERM is killed."""

_POLL = 0.2
"""Seconds between two polls of the other processes, and between two reports of progress."""
_CHECKS_IN_RESERVE = 8.0
"""Time kept for the last check and the figures of the result, in checks of a motion on the dense grid."""
_LARGEST_RESERVE = 0.2
"""The same, as a share of the whole time at most."""


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
        self._starts = later_starts(starts)
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
        return next(self._starts, None)

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


@dataclass(frozen=True, kw_only=True)
class SearchChoices(SearchOptions):
    """How long and how to search: for `time`, from so many starts, or both; start k is the same for any `workers`."""

    starts: int | None = 8

    @property
    def processes(self) -> int:
        """Return how many processes search, this one included: never more than there are starts."""
        workers = self.workers if self.workers is not None else os.cpu_count() or 1
        return workers if self.starts is None else min(workers, self.starts)


@dataclass(frozen=True)
class SearchResult:
    """Outcome of a search."""

    best: CandidateMotion | None  # the candidate of the least cost; None where there is none yet
    finished: int  # starts that went through all rounds
    seconds: float  # that the search took
    limit: float | None  # time limit [s]; None where it ends after a number of starts
    interrupted: bool = False  # whether Ctrl-C ended it
    died: int = 0  # processes that crashed or were killed


def search(
    problem: DesignProblem,
    make: Callable[[], DesignProblem],
    choices: SearchChoices,
    first: FloatArray | None = None,
    progress: Callable[[SearchResult], None] = lambda result: None,
    clock: Clock = SYSTEM_CLOCK,
    begun: float | None = None,
) -> SearchResult:
    """Search from `choices.starts` random starts, or for `choices.time`; Ctrl-C ends it with the best so far.

    This process searches too: it has a feasible motion while the others are still being started. Start 0 has one
    whatever the time limit; it begins at `first` where given. `make`, which must be picklable, builds the problem in
    another process. `progress` is called after each better candidate, and a few times per second. `choices.time` counts
    from `begun` by the clock, from now where None.

    Raises:
        NoFeasiblePoseError: no pose was found that keeps all limits; names the one that excludes them.
        IdentificationError: a process crashed, and the result would depend on it.
        UsageError, ConnectionFailedError: no such cluster.
        DynidError: from building the problem.
    """
    if choices.starts is None and choices.time is None:
        raise ValueError("a search needs a number of starts or a time limit")
    begun = clock.now() if begun is None else begun
    left = None if choices.time is None else begun + choices.time - clock.now()
    with _others(choices, make, left) as others:
        run = _Run(problem, choices, others, progress, clock, begun)
        try:
            run.all_starts(first)
        except TimeIsUpError:
            pass
        except KeyboardInterrupt:
            run.interrupted = True
        return run.result()


@contextmanager
def _others(
    choices: SearchChoices, make: Callable[[], DesignProblem], left: float | None
) -> Iterator[SearchProcesses | ClusterStarts]:
    """Who searches beside this process."""
    if not choices.scheduler:
        with SearchProcesses(
            choices.processes - 1, make, choices.seed, choices.solver, choices.starts, left
        ) as processes:
            yield processes
        return
    with cluster_executor(choices.scheduler) as executor:
        starts = ClusterStarts(executor, make, choices.seed, choices.solver, choices.starts, left)
        try:
            yield starts
        finally:
            starts.end()


class _Run:
    """State of this process: its starts, the best of all, the time."""

    def __init__(
        self,
        problem: DesignProblem,
        choices: SearchChoices,
        others: SearchProcesses | ClusterStarts,
        progress: Callable[[SearchResult], None],
        clock: Clock,
        begun: float,
    ) -> None:
        self.interrupted = False
        self._problem, self._choices, self._others = problem, choices, others
        self._progress, self._clock, self._begun = progress, clock, begun
        self._end = np.inf if choices.time is None else begun + choices.time
        self._best: CandidateMotion | None = None
        self._finished = 0
        self._next_look = begun + _POLL

    def all_starts(self, first: FloatArray | None) -> None:
        """Run starts until there are no more; then wait for the other processes.

        Raises:
            TimeIsUpError: at the deadline.
        """
        start: int | None = 0
        while start is not None:
            self._start(start, first)
            start = self._others.next_start()
        while self._others.running:
            self._check_time()
            self._look(_POLL)
        self._look(0.0)

    def _start(self, start: int, first: FloatArray | None) -> None:
        # A feasible motion is wanted however short the time is: start 0 begins to look at it with its first candidate.
        begin_tick = self.tick if start else no_tick
        seed = [self._choices.seed, start]
        begin = first if first is not None and start == 0 else random_start(self._problem, seed, tick=begin_tick)
        try:
            run_start(self._problem, start, begin, seed, self._choices.solver, self._take, self._tick_of(start))
        except NoFeasiblePoseError:
            if start == 0:
                raise

    def _tick_of(self, start: int) -> Callable[[], None]:
        return self.tick if start else lambda: None if self._best is None else self.tick()

    def tick(self) -> None:
        """Check the time and, now and then, the other processes.

        Raises:
            TimeIsUpError: at the deadline.
            IdentificationError: a process crashed, and its starts are missing.
        """
        self._check_time()
        if self._clock.now() >= self._next_look:
            self._look(0.0)

    def _check_time(self) -> None:
        if self._clock.now() >= self._end:
            raise TimeIsUpError

    def _look(self, timeout: float) -> None:
        """Collect the reports of other processes; wait at most `timeout` [s]."""
        for report in self._others.reports(timeout):
            self._add(report)
        if self._others.died and self._choices.starts is not None:
            raise IdentificationError("a search process crashed", hint="check the memory; --time tolerates it")
        self._progress(self.result())
        self._next_look = self._clock.now() + _POLL

    def _take(self, report: Report) -> None:
        """Handle this process's own reports."""
        is_first = self._best is None
        self._add(report)
        since = self._clock.now()
        if is_first and self._best is not None and self._choices.time is not None and since < self._end:
            accepted(self._problem, self._best.variables)
            reserve = _CHECKS_IN_RESERVE * (self._clock.now() - since)
            self._end -= min(reserve, _LARGEST_RESERVE * self._choices.time)

    def _add(self, report: Report) -> None:
        if isinstance(report, Finished):
            self._finished += 1
            return
        # Ties go to the lower start, whatever the order in which processes report.
        if self._best is None or (report.cost, report.start) < (self._best.cost, self._best.start):
            self._best = report
            self._progress(self.result())

    def result(self) -> SearchResult:
        """The outcome so far."""
        seconds = self._clock.now() - self._begun
        return SearchResult(
            self._best, self._finished, seconds, self._choices.time, self.interrupted, self._others.died
        )
