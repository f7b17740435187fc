"""Solvers and search on a problem whose optimum is known."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest
from toy_design import BEST, maker, toy_problem

from drivers.errors import IdentificationError, UsageError
from ident.excite.search import SearchChoices, SearchResult, search
from ident.excite.solve import solve

OPTIMUM = np.array([BEST[0], 0.99])  # the second joint's best place lies beyond its limit
has_ipopt = importlib.util.find_spec("cyipopt") is not None


@pytest.mark.parametrize(
    "solver",
    ["slsqp", "trust-constr", pytest.param("ipopt", marks=pytest.mark.skipif(not has_ipopt, reason="no cyipopt"))],
)
def test_solvers_reach_the_constrained_optimum(solver):
    problem = toy_problem()
    *_, last = solve(problem, np.array([0.3, 0.2]), solver)
    assert last == pytest.approx(OPTIMUM, abs=0.02)
    assert problem.use(last).max() <= 0.99 + 1e-6


@pytest.mark.skipif(has_ipopt, reason="cyipopt is installed")
def test_a_solver_that_is_not_installed_is_refused():
    with pytest.raises(UsageError, match="cyipopt"):
        list(solve(toy_problem(), np.zeros(2), "ipopt"))


def test_the_same_seed_gives_the_same_result_on_any_number_of_processes():
    alone = search(maker(), SearchChoices(seed=3, starts=4, workers=1))
    together = search(maker(), SearchChoices(seed=3, starts=4, workers=2))
    assert alone.best is not None
    assert together.best is not None
    assert np.array_equal(alone.best.variables, together.best.variables)
    assert alone.best.start == together.best.start
    assert alone.finished == together.finished == 4


def test_the_best_of_the_starts_is_kept_and_progress_is_told():
    seen = []
    found = search(maker(), SearchChoices(seed=0, starts=6, workers=1), progress=seen.append)
    assert found.best is not None
    assert found.best.cost == min(each.best.cost for each in seen if each.best is not None)
    costs = [each.best.cost for each in seen if each.best is not None]
    assert costs == sorted(costs, reverse=True)
    assert len(seen) == 6 * 3


@pytest.mark.parametrize(("workers", "starts", "processes"), [(1, 8, 1), (4, 3, 3), (4, None, 4), (None, 1, 1)])
def test_no_more_processes_than_starts(workers, starts, processes):
    assert SearchChoices(workers=workers, starts=starts).processes == processes


def test_the_first_start_can_be_given():
    found = search(maker(), SearchChoices(seed=0, starts=1, workers=1), first=np.array([0.49, 0.97]))
    assert found.best is not None
    assert found.best.variables == pytest.approx(OPTIMUM, abs=0.02)


@pytest.mark.parametrize("workers", [1, 2])
def test_time_ends_a_search_that_has_no_end(clock, workers):
    """At once: here every candidate takes a second, and the search has forty."""
    seen = []

    def second_later(found):
        seen.append(found)
        clock.stall(1.0)

    choices = SearchChoices(starts=None, seconds=40.0, workers=workers)
    found = search(maker(), choices, progress=second_later, clock=clock)
    assert [each.seconds for each in seen] == list(range(40))
    assert found.seconds == 40.0
    assert found.best == seen[-1].best is not None
    assert found.finished == 13 if workers == 1 else found.finished >= 12  # three rounds a start
    assert not found.interrupted


def test_a_search_whose_problem_takes_all_its_time_finds_nothing(clock):
    def slow():
        clock.stall(5.0)
        return toy_problem()

    found = search(slow, SearchChoices(starts=None, seconds=4.0, workers=1), clock=clock)
    assert found == SearchResult(None, None, 0, 5.0, False)


@pytest.mark.parametrize("workers", [1, 2])
def test_ctrl_c_gives_the_best_so_far(workers):
    def interrupt(found):
        if found.finished >= 2:
            raise KeyboardInterrupt

    found = search(maker(), SearchChoices(starts=10_000, workers=workers), progress=interrupt)
    assert found.interrupted
    assert found.best is not None


def test_an_error_of_a_process_reaches_the_caller():
    with pytest.raises(UsageError, match="on purpose"):
        search(maker(fault="raise"), SearchChoices(starts=2, workers=2))


def test_a_process_that_dies_is_noticed():
    with pytest.raises(IdentificationError, match="exit status 3"):
        search(maker(fault="die"), SearchChoices(starts=2, workers=2))


def test_a_search_needs_an_end():
    with pytest.raises(ValueError, match="time limit"):
        search(maker(), SearchChoices(starts=None))
