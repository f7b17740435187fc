"""Friction that changes from run to run is in its error bars, and costs nothing where it does not change."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from daq.robot.loader import RobotFile, parse_robot
from ident.identify.identification import IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.model.true_parameters import true_model, truth_vector
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.regression.repeatability import RunDeviations, repeatability
from ident.result.friction import friction_note
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from tests.ident.identify.friction.test_friction import ARM

JOINTS, SEEDS = 6, 200


def meta_analysis(count: int, movement: float, seed: int) -> tuple[float, float]:
    """Share of true means inside their intervals, and the mean growth of these, for `count` runs of six joints."""
    generator = np.random.default_rng(seed)
    inside, growth = [], []
    for _ in range(SEEDS):
        sizes = generator.uniform(1.0, 20.0, JOINTS)
        own = generator.uniform(0.01, 0.03, (count, JOINTS)) * sizes
        moved = movement * sizes * generator.standard_normal((count, JOINTS))
        values = moved + own * generator.standard_normal((count, JOINTS))
        std, factor = repeatability(RunDeviations(values, own**2, sizes, ("coulomb",) * JOINTS))
        within = np.mean(own**2, axis=0) / count
        total = np.sqrt(within + (std * factor) ** 2 / count)
        inside.append(np.abs(np.mean(values, axis=0)) < WITHIN_95_PERCENT * total)
        growth.append(total / np.sqrt(within))
    return float(np.mean(inside)), float(np.mean(growth))


@pytest.mark.parametrize("count", [2, 3, 8])
def test_the_mean_of_runs_is_covered_whether_friction_moves_or_not(count):
    inside, growth = meta_analysis(count, 0.1, count)
    assert 0.93 < inside < 0.98
    assert growth > 3.0
    inside, growth = meta_analysis(count, 0.0, count)
    assert 0.94 < inside < 0.98
    assert growth < (1.2 if count == 2 else 1.1)


def test_one_joint_that_moves_alone_has_an_interval_of_its_own():
    generator = np.random.default_rng(1)
    sizes, own = np.full(JOINTS, 10.0), np.full((8, JOINTS), 0.1)
    values = own * generator.standard_normal((8, JOINTS))
    values[:, 2] += 1.5 * generator.standard_normal(8)
    std, _ = repeatability(RunDeviations(values, own**2, sizes, ("viscous",) * JOINTS))
    assert std[2] == pytest.approx(np.std(values[:, 2], ddof=1), rel=0.05)
    assert np.all(np.delete(std, 2) < std[2])


def arm(factor: float) -> RobotFile:
    """The arm whose Coulomb and viscous friction is that of its file times a factor."""
    content = yaml.safe_load(ARM)
    for joint in content["truth"]["joints"].values():
        joint |= {"viscous": factor * joint["viscous"], "coulomb": factor * joint["coulomb"]}
        for term in ("alpha", "stribeck", "stribeck_velocity", "load", "temperature"):
            del joint[term]
    return parse_robot(yaml.safe_dump(content), where="arm", folder=None)


def test_an_identification_of_several_runs_states_the_repeatability():
    nominal, factors = arm(1.0), (1.0, 0.85, 1.0, 1.15)
    motions = [random_fourier_motion(true_model(nominal), 5.0, seed, 1) for seed in range(4)]
    held_out, *runs = [
        simulate_recording(arm(factor), motion, 5.0, seed)
        for seed, (factor, motion) in enumerate(zip(factors, motions, strict=True))
    ]
    choices = IdentifyChoices(model=ModelChoices(friction="coulomb-viscous"), search_delay=False, presliding=False)
    found = identify(runs, [held_out], choices)
    result = found.result
    truth = found.base.projection @ truth_vector(nominal, found.model)
    for place, parameter in enumerate(result.base_parameters):
        assert parameter.value is not None
        assert parameter.std is not None
        assert abs(parameter.value - truth[place]) < 2.5 * parameter.std, parameter.name
        if parameter.kind in ("viscous", "coulomb"):
            assert parameter.repeatability == pytest.approx(0.15 * truth[place], rel=0.5)
            assert parameter.std > 0.3 * (parameter.repeatability or 0.0)
        elif parameter.kind != "offset":
            assert parameter.repeatability is None
    assert "3 runs" in result.friction_note
    assert result.friction[0].repeatability_text


def test_one_run_says_what_its_intervals_do_not_cover():
    assert "one run: they do not cover how much friction changes" in friction_note(1, None)
