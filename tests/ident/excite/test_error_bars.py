"""The worst error bar that progress tells, against the forecast of the motion."""

from __future__ import annotations

import numpy as np
import pytest

from daq.motion.trajectories import RestToRest
from daq.robot.loader import load_robot
from ident.excite.choices import DesignChoices
from ident.excite.design import build_problem
from ident.excite.forecast import excitation_figures
from ident.excite.prior import PriorKnowledge, find_prior

UP6 = load_robot("up6")


@pytest.mark.parametrize("periods", [1, 4])
def test_it_is_that_of_the_forecast_but_for_the_ramps(periods):
    prior = find_prior(UP6)
    problem = build_problem(UP6, prior, DesignChoices(periods=periods))
    x = problem.family.random(np.random.default_rng(0))
    assert problem.error_bars is not None
    worst = problem.error_bars.worst(problem.path(x))
    motion = problem.family.motion(x)
    assert isinstance(motion, RestToRest)
    told = {entry.name: entry for entry in excitation_figures(UP6, motion, prior).forecast.parameters}
    expected = 196.0 * told[worst.name].std / problem.error_bars.sizes[list(problem.error_bars.names).index(worst.name)]
    assert worst.percent == pytest.approx(expected, rel=0.25)


def test_a_parameter_that_is_not_excited_has_no_finite_error_bar():
    problem = build_problem(UP6, find_prior(UP6), DesignChoices())
    still = problem.family.about(np.ones(problem.family.size), np.zeros(3), 0.0)
    assert problem.error_bars is not None
    assert problem.error_bars.worst(problem.path(still)).percent > 1e6


def test_without_parameters_there_is_none():
    known = find_prior(UP6)
    prior = PriorKnowledge(None, known.noise, "nothing", known.rate)
    assert build_problem(UP6, prior, DesignChoices()).error_bars is None
