"""Frog leaping as a solver of excitation designs."""

from __future__ import annotations

import numpy as np
import pytest
from toy_design import BEST, maker, slow_problem, toy_problem

from daq.robot.loader import load_robot
from ident.excite.choices import DesignChoices
from ident.excite.design import build_problem
from ident.excite.prior import find_prior
from ident.excite.search.search import SearchChoices, search

OPTIMUM = np.array([BEST[0], 0.99])


def test_frogs_reach_the_constrained_optimum_and_every_candidate_keeps_the_limits():
    told = []
    choices = SearchChoices(starts=1, workers=1, solver="sfla")
    found = search(toy_problem(), maker(), choices, progress=lambda result: told.append(result.best))
    assert found.best.variables == pytest.approx(OPTIMUM, abs=0.03)
    assert found.finished == 1
    candidates = [best for best in told if best is not None]
    assert all(toy_problem().use(best.variables).max() <= 0.99 + 1e-6 for best in candidates)
    costs = [best.cost for best in candidates]
    assert costs == sorted(costs, reverse=True)


def test_time_and_ctrl_c_end_them_with_the_best_so_far(clock):
    choices = SearchChoices(starts=None, time=10.0, workers=1, solver="sfla")
    found = search(slow_problem(clock, 0.01), maker(), choices, clock=clock)
    assert 8.0 <= found.seconds <= 10.1
    assert found.best is not None

    evaluations = 0

    def interrupt() -> float:
        nonlocal evaluations
        evaluations += 1
        if evaluations > 300:
            raise KeyboardInterrupt
        return 0.0

    problem = slow_problem(clock, 0.0)
    problem.constraints[0]._clock = type("Clock", (), {"stall": lambda self, seconds: interrupt()})()
    found = search(problem, maker(), SearchChoices(starts=5, workers=1, solver="sfla"), clock=clock)
    assert found.interrupted
    assert found.best is not None


def test_an_arms_motion_grows_with_the_papers_criterion():
    up6 = load_robot("up6")
    problem = build_problem(up6, find_prior(up6), DesignChoices(kind="sines", criterion="motion-size", harmonics=3))
    found = []

    def after_some(result) -> None:
        if result.best is not None:
            found.append(result.best)
        if len(found) > 15:
            raise KeyboardInterrupt

    search(problem, maker(), SearchChoices(starts=1, workers=1, solver="sfla"), progress=after_some)
    assert found[-1].cost < found[0].cost - 0.1
    assert problem.use(found[-1].variables).max() <= problem.allowed + 1e-6
