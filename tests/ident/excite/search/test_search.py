"""Solvers and search on a problem whose optimum is known."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import active_children
from multiprocessing.connection import wait

import numpy as np
import pytest
from each import each
from toy_design import BEST, impossible_problem, maker, slow_problem, toy_problem

from drivers.core.errors import IdentificationError, UsageError
from ident.excite.search import search as processes_module
from ident.excite.search.poses import NoFeasiblePoseError
from ident.excite.search.search import SearchChoices, search
from ident.excite.search.start import solve

OPTIMUM = np.array([BEST[0], 0.99])  # the second joint's best place lies beyond its limit


def test_a_solver_reaches_the_constrained_optimum():
    problem = toy_problem()
    *_, last = solve(problem, np.array([0.3, 0.2]))
    assert last == pytest.approx(OPTIMUM, abs=0.02)
    assert problem.use(last).max() <= 0.99 + 1e-6


def search_toy(choices, fault="", **more):
    """The toy problem here is sound; the one that other processes make has the fault."""
    return search(toy_problem(), maker(fault=fault), choices, **more)


def test_the_same_seed_gives_the_same_result_on_any_number_of_processes():
    alone = search_toy(SearchChoices(seed=3, starts=4, workers=1))
    together = search_toy(SearchChoices(seed=3, starts=4, workers=2))
    assert alone.best is not None
    assert together.best is not None
    assert np.array_equal(alone.best.variables, together.best.variables)
    assert alone.best.start == together.best.start
    assert alone.finished == together.finished == 4


def test_the_best_of_all_candidates_is_kept_and_progress_is_told():
    seen = []
    found = search_toy(SearchChoices(seed=0, starts=6, workers=1), progress=seen.append)
    assert found.best is not None
    costs = [each.best.cost for each in seen]
    assert costs == sorted(costs, reverse=True)
    assert found.best.cost == costs[-1]
    assert found.best.variables == pytest.approx(OPTIMUM, abs=0.02)
    # Iterates count, not only what a round ends with.
    assert len({each.best.cost for each in seen if each.finished == 0}) > 3


@each(("workers", "starts", "processes"), [(1, 8, 1), (4, 3, 3), (4, None, 4), (None, 1, 1)])
def test_no_more_processes_than_starts(workers, starts, processes):
    assert SearchChoices(workers=workers, starts=starts).processes == processes


def test_the_first_start_can_be_given():
    found = search_toy(SearchChoices(seed=0, starts=1, workers=1), first=np.array([0.49, 0.97]))
    assert found.best is not None
    assert found.best.variables == pytest.approx(OPTIMUM, abs=0.02)


@pytest.mark.parametrize("workers", [1, 2])
def test_time_ends_a_search_that_has_no_end(clock, workers):
    """Every evaluation takes 10 ms here, so that the search ends within a few of them."""
    found = search(
        slow_problem(clock, 0.01), maker(), SearchChoices(starts=None, time=10.0, workers=workers), clock=clock
    )
    assert 8.0 <= found.seconds <= 10.1
    assert found.best is not None
    assert found.best.variables == pytest.approx(OPTIMUM, abs=0.02)
    assert found.limit == 10.0
    assert not found.interrupted


def test_however_short_the_time_there_is_a_feasible_motion(clock):
    """A single evaluation takes more than the search has."""
    found = search(slow_problem(clock, 2.0), maker(), SearchChoices(starts=None, time=1.0, workers=1), clock=clock)
    assert found.best is not None
    assert toy_problem().use(found.best.variables).max() <= 0.99
    assert found.seconds <= 10.0


def test_time_is_kept_for_the_last_check(clock):
    """A check of a motion takes three evaluations of the limits; eight checks are kept for what follows the search."""
    choices = SearchChoices(starts=None, time=100.0, workers=1)
    found = search(slow_problem(clock, 0.1), maker(), choices, clock=clock)
    assert 100.0 - 8 * 3 * 0.1 - 1.0 <= found.seconds <= 100.0 - 2.0


@pytest.mark.parametrize("workers", [1, 2])
def test_ctrl_c_gives_the_best_so_far(workers):
    def interrupt(found):
        if found.finished >= 2:
            raise KeyboardInterrupt

    found = search_toy(SearchChoices(starts=10_000, workers=workers), progress=interrupt)
    assert found.interrupted
    assert found.best is not None


def test_a_start_from_outside_the_limits_is_led_back_to_them():
    found = search_toy(SearchChoices(starts=1, workers=1), first=np.array([5.0, 7.0]))
    assert found.best is not None
    assert toy_problem().use(found.best.variables).max() <= 0.99 + 1e-6


def test_limits_that_exclude_every_pose_are_named():
    with pytest.raises(
        NoFeasiblePoseError, match=r"each of \d+ poses tried uses at least .* of the distance from here"
    ):
        search(impossible_problem(), maker(), SearchChoices(starts=1, workers=1))


def test_an_error_of_a_process_reaches_the_caller():
    with pytest.raises(UsageError, match="on purpose"):
        search_toy(SearchChoices(starts=2, workers=2), fault="raise")


def test_a_process_that_dies_is_noticed_where_the_result_depends_on_it():
    with pytest.raises(IdentificationError, match="process crashed"):
        search_toy(SearchChoices(starts=2, workers=2), fault="die")


def test_with_a_time_limit_the_search_goes_on_without_a_process_that_died(clock):
    def interrupt(found):
        if children := active_children():  # or this process would search on meanwhile
            wait([child.sentinel for child in children], 60.0)
        if found.died and found.finished > 1:
            raise KeyboardInterrupt

    choices = SearchChoices(starts=None, time=6e5, workers=2)
    found = search(slow_problem(clock, 0.1), maker(fault="die"), choices, progress=interrupt, clock=clock)
    assert found.died == 1
    assert found.best is not None


def test_a_process_that_does_not_answer_is_ended(monkeypatch):
    monkeypatch.setattr(processes_module, "_JOINING", 0.0)
    others = processes_module.SearchProcesses(1, maker(fault="hang"), 0, "slsqp", None, None)
    with others:
        assert others.running == 1
    assert others.running == 0


def test_a_search_needs_an_end():
    with pytest.raises(ValueError, match="time limit"):
        search_toy(SearchChoices(starts=None))


def test_a_cluster_finds_the_same_as_this_process_alone():
    distributed = pytest.importorskip("distributed", reason="needs the extra 'dask'")
    alone = search_toy(SearchChoices(seed=3, starts=4, workers=1))
    with distributed.LocalCluster(n_workers=1, processes=False, dashboard_address=None) as local:
        found = search_toy(SearchChoices(seed=3, starts=4, scheduler=local.scheduler_address))
        with pytest.raises(UsageError, match="on purpose"):
            search_toy(SearchChoices(seed=3, starts=4, scheduler=local.scheduler_address), fault="raise")
    assert alone.best is not None
    assert found.best is not None
    assert np.array_equal(alone.best.variables, found.best.variables)
    assert (alone.best.start, alone.finished) == (found.best.start, found.finished)


def test_a_worker_of_a_cluster_that_is_lost_is_noticed(monkeypatch):
    class Lost(ThreadPoolExecutor):
        def submit(self, *_):
            return super().submit(os.strerror, "not a number")

    monkeypatch.setattr(processes_module, "cluster_executor", lambda _: Lost(1))
    with pytest.raises(IdentificationError, match="process crashed"):
        search_toy(SearchChoices(seed=3, starts=2, scheduler="tcp://nowhere"))
