"""Multistart search on all cores; it keeps the best candidate so far, however it ends."""

from __future__ import annotations

import multiprocessing
import os
import queue
import signal
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.process import BaseProcess
from typing import Any

import numpy as np

from drivers.clock import SYSTEM_CLOCK, Clock
from drivers.errors import DynidError, IdentificationError
from drivers.streams import FloatArray
from ident.excite.problem import Problem
from ident.excite.solve import ROUNDS, Solver, solve

DRAWS = 20
"""Random members that a start is chosen from."""
_ROUNDING = 1e-6
_POLL = 0.2


@dataclass(frozen=True)
class SearchChoices:
    """How long and how to search.

    Attributes:
        seed: of the random starts; start k is the same whatever the number of processes.
        starts: how many; None for as many as `seconds` allow, which depends on the machine.
        seconds: after which the search ends with what it has; None for no limit.
        workers: processes; one per core where None, this one alone where 1.
        solver: of the local problems.
    """

    seed: int = 0
    starts: int | None = 8
    seconds: float | None = None
    workers: int | None = None
    solver: Solver = "slsqp"

    @property
    def processes(self) -> int:
        """How many processes search: never more than there are starts."""
        workers = self.workers if self.workers is not None else os.cpu_count() or 1
        return workers if self.starts is None else min(workers, self.starts)


@dataclass(frozen=True)
class Candidate:
    """State of a start after a round.

    Attributes:
        start: number of the start.
        finished: whether that was its last round.
        cost: the criterion, exactly (a logarithm).
        condition: column-normalised condition number of the base regressor.
        use: the largest limit utilisation on the problem's grid.
        allowed: whether that is within the problem's margin.
        variables: (size,).
    """

    start: int
    finished: bool
    cost: float
    condition: float
    use: float
    allowed: bool
    variables: FloatArray


@dataclass(frozen=True)
class SearchResult:
    """Outcome of a search.

    Attributes:
        best: the feasible candidate of the least cost; None where no start became feasible.
        least_use: the candidate that came nearest to the limits, for the message where none is feasible.
        finished: starts that went through all rounds.
        seconds: that the search took.
        interrupted: whether Ctrl-C ended it.
    """

    best: Candidate | None
    least_use: Candidate | None
    finished: int
    seconds: float
    interrupted: bool


@dataclass
class _Ledger:
    clock: Clock
    begun: float
    best: Candidate | None = None
    least_use: Candidate | None = None
    finished: int = 0

    def add(self, candidate: Candidate) -> None:
        self.finished += candidate.finished
        if self.least_use is None or (candidate.use, candidate.start) < (self.least_use.use, self.least_use.start):
            self.least_use = candidate
        # Ties go to the lower start, whatever the order in which processes report.
        if candidate.allowed and (
            self.best is None or (candidate.cost, candidate.start) < (self.best.cost, self.best.start)
        ):
            self.best = candidate

    def result(self, *, interrupted: bool) -> SearchResult:
        return SearchResult(self.best, self.least_use, self.finished, self.clock.now() - self.begun, interrupted)


def search(
    make: Callable[[], Problem],
    choices: SearchChoices,
    first: FloatArray | None = None,
    progress: Callable[[SearchResult], None] = lambda result: None,
    clock: Clock = SYSTEM_CLOCK,
) -> SearchResult:
    """Search from `choices.starts` random starts, or for `choices.seconds`; Ctrl-C ends it with the best so far.

    Args:
        make: builds the problem; called once in every process that searches, so it must be picklable for several.
        choices: see there. One of `starts` and `seconds` must be given.
        first: variables of start 0, in place of random ones.
        progress: called after each round of a start.
        clock: the host's.

    Raises:
        IdentificationError: a process died.
        DynidError: what building the problem raised.
    """
    if choices.starts is None and choices.seconds is None:
        raise ValueError("a search needs a number of starts or a time limit")
    begun = clock.now()
    end = np.inf if choices.seconds is None else begun + choices.seconds
    ledger = _Ledger(clock, begun)
    source = (_own_candidates if choices.processes <= 1 else _their_candidates)(make, choices, first, clock, end)
    interrupted = False
    try:
        for candidate in source:
            ledger.add(candidate)
            progress(ledger.result(interrupted=False))
    except KeyboardInterrupt:
        interrupted = True
    finally:
        source.close()
    return ledger.result(interrupted=interrupted)


def candidates(problem: Problem, choices: SearchChoices, start: int, first: FloatArray | None) -> Iterator[Candidate]:
    """The candidates of one start, round by round."""
    begin = first if start == 0 and first is not None else random_start(problem, [choices.seed, start])
    for finished_rounds, variables in enumerate(solve(problem, begin, choices.solver), start=1):
        use = float(problem.use(variables).max(initial=0.0))
        cost, condition = problem.cost(variables), problem.condition(variables)
        allowed = use <= problem.allowed + _ROUNDING
        yield Candidate(start, finished_rounds == len(ROUNDS), cost, condition, use, allowed, variables)


def random_start(problem: Problem, seed: Sequence[int], draws: int = DRAWS) -> FloatArray:
    """The first of `draws` random members that keeps all limits, or the one that passes them least; (size,).

    From deep within a collision a local solver does not find its way out.
    """
    generator = np.random.default_rng(seed)
    best: tuple[float, FloatArray] | None = None
    for _ in range(draws):
        variables = problem.family.random(generator)
        use = float(problem.use(variables).max(initial=0.0))
        if best is None or use < best[0]:
            best = use, variables
        if use <= problem.allowed:
            break
    assert best is not None
    return best[1]


def _own_candidates(
    make: Callable[[], Problem], choices: SearchChoices, first: FloatArray | None, clock: Clock, end: float
) -> Any:  # a generator, whose close() the caller needs
    problem = make()
    start = 0
    while (choices.starts is None or start < choices.starts) and clock.now() < end:
        for candidate in candidates(problem, choices, start, first):
            yield candidate
            if clock.now() >= end:
                return
        start += 1


def _their_candidates(
    make: Callable[[], Problem], choices: SearchChoices, first: FloatArray | None, clock: Clock, end: float
) -> Any:
    # spawn: a forked child would inherit the threads' locks of whatever this process has been doing.
    context = multiprocessing.get_context("spawn")
    results: Any = context.Queue()
    counter = context.Value("q", 0)
    processes = [
        context.Process(target=_work, args=(make, choices, first, counter, results), daemon=True)
        for _ in range(choices.processes)
    ]
    for process in processes:
        process.start()
    try:
        running = len(processes)
        while running and clock.now() < end:
            try:
                # Other processes run by the computer's clock, whatever ours is.
                message = results.get(timeout=min(_POLL, max(end - clock.now(), 0.0)))
            except queue.Empty:
                _check_alive(processes)
                continue
            if message is None:
                running -= 1
            elif isinstance(message, DynidError):
                raise message
            else:
                yield message
    finally:
        for process in processes:
            process.terminate()
        for process in processes:
            process.join()


def _check_alive(processes: Sequence[BaseProcess]) -> None:
    for process in processes:
        if process.exitcode not in (None, 0):
            raise IdentificationError(f"a search process died with exit status {process.exitcode}")


def _work(
    make: Callable[[], Problem], choices: SearchChoices, first: FloatArray | None, counter: Any, results: Any
) -> None:
    # Ctrl-C reaches the whole process group; the parent decides.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        problem = make()
        while True:
            with counter.get_lock():
                start = counter.value
                counter.value += 1
            if choices.starts is not None and start >= choices.starts:
                break
            for candidate in candidates(problem, choices, start, first):
                results.put(candidate)
    except DynidError as error:
        results.put(error)
        return
    results.put(None)
