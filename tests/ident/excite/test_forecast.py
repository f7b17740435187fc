"""Figures of a motion against their definitions, and predicted error bars against those of simulated recordings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from daq.motion.limits import motion_extremes
from daq.motion.trajectories import RestToRest
from daq.robot.loader import load_robot
from drivers.core.arrays import FloatArray
from ident.excite import forecast as module
from ident.excite.choices import DesignChoices
from ident.excite.design import build_problem
from ident.excite.forecast import excitation_figures
from ident.excite.prior import PriorKnowledge, find_prior
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.regressor import model_torque, regressor
from sim_drivers.synthetic.measurement import random_fourier_motion

RATE = 200.0  # of the three-joint arm's truth


@pytest.fixture(scope="module")
def motion(three_joint) -> RestToRest:
    return RestToRest(random_fourier_motion(build_model(three_joint), 8.0, seed=1), 1, 1.0)


def weighted_rows(robot_file, motion) -> tuple[FloatArray, FloatArray]:
    """The base regressor (n·N, b) along the motion, plain and with each joint's rows over its noise."""
    model = build_model(robot_file)
    time = np.arange(round(motion.duration * RATE)) / RATE
    dense = regressor(model, *motion.evaluate(time), base_parameters(model).columns)
    noise = find_prior(robot_file).noise
    plain = dense.transpose(0, 2, 1)
    return plain.reshape(-1, dense.shape[1]), (plain / noise[:, None, None]).reshape(-1, dense.shape[1])


def test_figures_are_the_direct_formulas(three_joint, motion):
    prior = find_prior(three_joint)
    forecast = excitation_figures(three_joint, motion, prior).forecast
    plain, weighted = weighted_rows(three_joint, motion)
    assert forecast.condition == pytest.approx(np.linalg.cond(plain), rel=1e-6)
    assert forecast.scaled_condition == pytest.approx(np.linalg.cond(plain / np.linalg.norm(plain, axis=0)), rel=1e-6)
    information = weighted.T @ weighted
    assert forecast.log_det == pytest.approx(np.linalg.slogdet(information)[1], abs=1e-6)
    std = np.sqrt(np.diag(np.linalg.inv(information)))
    assert [p.std for p in forecast.parameters] == pytest.approx(std, rel=1e-6)
    assert prior.parameters is not None
    expected = [100 * s / abs(v) if v else np.inf for s, v in zip(std, prior.parameters, strict=True)]
    assert [p.rsd_percent for p in forecast.parameters] == pytest.approx(expected, rel=1e-6)
    base = base_parameters(build_model(three_joint))
    assert tuple(p.name for p in forecast.parameters) == base.names
    assert forecast.unexcited == ()


def test_predicted_std_is_the_spread_over_noise_draws(three_joint, motion):
    predicted = [p.std for p in excitation_figures(three_joint, motion, find_prior(three_joint)).forecast.parameters]
    _, weighted = weighted_rows(three_joint, motion)
    # In rows over their noise, white noise has a standard deviation of 1.
    noise = np.random.default_rng(7).standard_normal((len(weighted), 30))
    errors = np.linalg.lstsq(weighted, noise, rcond=None)[0]
    spread = np.sqrt(np.mean(errors**2, axis=1))
    # 30 draws know a standard deviation to 13 %: 4 of these for one parameter. The parameters' errors depend on each
    # other, so that their mean square is known to about 10 %: 3 of these.
    assert spread / predicted == pytest.approx(1.0, abs=0.52)
    assert np.mean((spread / predicted) ** 2) == pytest.approx(1.0, abs=0.3)


def test_noise_counts_by_its_density(three_joint, motion):
    prior = find_prior(three_joint)
    usual = excitation_figures(three_joint, motion, prior).forecast.parameters
    for other, factor in ((replace(prior, noise=3.0 * prior.noise), 3.0), (replace(prior, rate=4.0 * prior.rate), 0.5)):
        changed = excitation_figures(three_joint, motion, other).forecast.parameters
        assert [p.std for p in changed] == pytest.approx([factor * p.std for p in usual], rel=1e-6)


def test_longer_motions_are_thinned_without_harm(three_joint, motion, monkeypatch):
    prior = find_prior(three_joint)
    usual = excitation_figures(three_joint, motion, prior)
    monkeypatch.setattr(module, "MOST_SAMPLES", 700)
    thinned = excitation_figures(three_joint, motion, prior)
    ratio = [b.std / a.std for a, b in zip(usual.forecast.parameters, thinned.forecast.parameters, strict=True)]
    assert np.array(ratio) == pytest.approx(1.0, abs=0.02)
    assert thinned.forecast.log_det == pytest.approx(usual.forecast.log_det, abs=0.2)


def test_twice_the_periods_give_one_over_root_two(three_joint, motion):
    prior = find_prior(three_joint)
    periods = [
        [p.std for p in excitation_figures(three_joint, replace(motion, periods=k), prior).forecast.parameters]
        for k in (10, 20)
    ]
    assert np.array(periods[1]) / periods[0] == pytest.approx(np.sqrt(0.5), rel=0.02)  # but for the ramps


def test_limit_use_is_that_of_the_extremes(three_joint, motion):
    figures = excitation_figures(three_joint, motion, find_prior(three_joint))
    extremes = motion_extremes(motion)
    for number, (joint, limits) in enumerate(zip(figures.joints, three_joint.robot.joints, strict=True)):
        assert joint.joint == limits.name
        assert (joint.lowest, joint.highest) == (extremes.lowest[number], extremes.highest[number])
        assert joint.velocity_use == extremes.velocity[number] / limits.velocity
        assert joint.acceleration_use == extremes.acceleration[number] / limits.acceleration
        # ±3 rad: the middle is 0
        assert joint.position_use == max(-extremes.lowest[number], extremes.highest[number]) / 3.0
    named = {
        f"{quantity} of {joint.joint}": getattr(joint, f"{quantity}_use")
        for joint in figures.joints
        for quantity in ("position", "velocity", "acceleration", "torque")
    }
    assert figures.worst_use == max(named.values()) == named[figures.worst_limit]
    assert figures.duration == motion.duration
    quantity, _, name = figures.worst_limit.partition(" of ")
    index = three_joint.robot.joint_names.index(name)
    at = motion.evaluate(np.array([figures.worst_time]))[("position", "velocity", "acceleration").index(quantity)]
    limit = getattr(three_joint.robot.joints[index], quantity)
    assert abs(at[index, 0]) / np.max(limit) == pytest.approx(figures.worst_use, rel=1e-9)


def test_torque_use_needs_a_prior(three_joint, motion):
    prior = find_prior(three_joint)
    assert prior.parameters is not None
    model = build_model(three_joint)
    time = np.linspace(0.0, motion.duration, 20_001)
    torque = model_torque(model, base_parameters(model).columns, prior.parameters, *motion.evaluate(time))
    found = [joint.torque for joint in excitation_figures(three_joint, motion, prior).joints]
    assert found == pytest.approx(np.abs(torque).max(axis=1), rel=1e-3)
    without = excitation_figures(three_joint, motion, replace(prior, parameters=None))
    assert all(joint.torque is None and joint.torque_use is None for joint in without.joints)
    assert all(p.value is None and p.rsd_percent is None and p.std > 0 for p in without.forecast.parameters)


def test_a_joint_at_rest_leaves_its_parameters_unexcited(three_joint, motion):
    still = motion.motion
    sine, cosine = still.sine.copy(), still.cosine.copy()
    sine[1] = cosine[1] = 0.0
    resting = replace(motion, motion=replace(still, sine=sine, cosine=cosine))
    forecast = excitation_figures(three_joint, resting, find_prior(three_joint)).forecast
    assert {"Fv2", "Fs2"} <= set(forecast.unexcited)
    for parameter in forecast.parameters:
        assert np.isinf(parameter.std) == (parameter.name in forecast.unexcited)
    assert np.isfinite(forecast.log_det)


def test_a_motion_that_stands_still_excites_hardly_anything(three_joint, motion):
    still = motion.motion
    nothing = replace(motion, motion=replace(still, sine=0 * still.sine, cosine=0 * still.cosine))
    forecast = excitation_figures(three_joint, nothing, find_prior(three_joint)).forecast
    assert len(forecast.unexcited) > 0.8 * len(forecast.parameters)


def test_ten_thousand_repetitions_are_forecast_from_as_many_as_fit(three_joint, motion):
    """Their information adds up, and each takes the same values as the others."""
    prior = find_prior(three_joint)
    once, often = (excitation_figures(three_joint, replace(motion, periods=count), prior) for count in (40, 10_000))
    ratio = np.sqrt(once.duration / often.duration)
    before, after = ([p.std for p in figures.forecast.parameters] for figures in (once, often))
    assert after == pytest.approx(ratio * np.array(before), rel=0.05)
    assert often.worst_use == pytest.approx(once.worst_use, rel=1e-9)


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
