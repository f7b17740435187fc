"""Starts of a search on the workers of a Dask cluster, beside those of this process."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import suppress

from drivers.core.clock import SYSTEM_CLOCK
from drivers.core.errors import DynidError
from ident.excite.choices import Solver
from ident.excite.search.poses import NoFeasiblePoseError
from ident.excite.search.problem import DesignProblem
from ident.excite.search.start import Report, later_starts, random_start, run_start

IN_FLIGHT = 32
"""Starts that a cluster has been given at once; a search for a time submits the next as one ends."""


class TimeIsUpError(Exception):
    """The search's time is over."""


class ClusterStarts:
    """Gives starts to a cluster and reports their results, each when it has ended.

    Args:
        executor: the cluster's workers.
        make: builds the problem on a worker; picklable.
        seed: of the starts.
        solver: of the local problems.
        starts: after so many starts it ends; None for no end.
        seconds: after which the starts end; None for no end.

    Attributes:
        died: starts whose worker was lost.
    """

    def __init__(
        self,
        executor: Executor,
        make: Callable[[], DesignProblem],
        seed: int,
        solver: Solver,
        starts: int | None,
        seconds: float | None,
    ) -> None:
        self.died = 0
        self._executor, self._make, self._seed, self._solver = executor, make, seed, solver
        self._end = None if seconds is None else SYSTEM_CLOCK.now() + seconds
        self._starts = later_starts(starts)
        self._running: set[Future[list[Report]]] = set()
        for _ in range(IN_FLIGHT):
            self._submit()

    def next_start(self) -> int | None:
        """The next start that has not begun; None where all have."""
        return next(self._starts, None)

    @property
    def running(self) -> int:
        """Starts that have not ended."""
        return len(self._running)

    def reports(self, timeout: float = 0.0) -> Iterator[Report]:
        """New reports; waits for the first start to end, at most `timeout` [s].

        Raises:
            DynidError: from building the problem on a worker.
        """
        ended, self._running = wait(self._running, timeout, FIRST_COMPLETED)
        for future in ended:
            try:
                yield from future.result()
            except DynidError:
                raise
            except Exception:  # a worker that was lost, or the scheduler
                self.died += 1
            self._submit()

    def end(self) -> None:
        """Take back what has not begun."""
        for future in self._running:
            future.cancel()

    def _submit(self) -> None:
        left = None if self._end is None else self._end - SYSTEM_CLOCK.now()
        if (left is None or left > 0.0) and (start := self.next_start()) is not None:
            self._running.add(self._executor.submit(whole_start, self._make, self._seed, start, self._solver, left))


def whole_start(
    make: Callable[[], DesignProblem], seed: int, start: int, solver: Solver, seconds: float | None
) -> list[Report]:
    """The reports of a start, as far as it came in `seconds`; called on a worker.

    Raises:
        DynidError: from building the problem.
    """
    end = None if seconds is None else SYSTEM_CLOCK.now() + seconds
    reports: list[Report] = []

    def tick() -> None:
        if end is not None and SYSTEM_CLOCK.now() >= end:
            raise TimeIsUpError

    problem = make()
    with suppress(NoFeasiblePoseError, TimeIsUpError):
        begin = random_start(problem, [seed, start], tick=tick)
        run_start(problem, start, begin, [seed, start], solver, reports.append, tick)
    return reports
