"""What a wrong gain does to base parameters, against what it does when the data are identified with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from daq.robot.loader import load_robot, parse_robot
from drivers.core.errors import UsageError
from ident.identify.identification import IdentifyChoices
from ident.identify.identify import identify
from ident.model.dynamic_model import build_model
from ident.regression.least_squares import ordinary_least_squares, weighted_least_squares
from ident.regression.systematic_errors import beyond_chance, gain_sensitivity, relative_gain_std
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording

pytestmark = pytest.mark.usefixtures("estimates_alone", "stated_friction")


@pytest.fixture(scope="module")
def recording(three_joint):
    return simulate_recording(three_joint, random_fourier_motion(build_model(three_joint), 20.0, 3), 28.0, 3)


@pytest.mark.parametrize("joint", [0, 1, 2])
def test_it_is_what_another_gain_gives(recording, three_joint, joint):
    choices = IdentifyChoices(method="ols", search_delay=False)
    found = identify([recording], [], choices)
    name = three_joint.robot.joint_names[joint]
    gain = three_joint.robot.drive(name).gain
    text = three_joint.text.replace(f"joint: {name}, gain: {gain:g}", f"joint: {name}, gain: {1.01 * gain!r}")
    assert text != three_joint.text
    other = identify([recording], [], choices, parse_robot(text, where="other gain", folder=None))
    moved = other.solution.parameters - found.solution.parameters
    expected = 0.01 * gain_sensitivity(found.reduction, found.solution)[:, joint]
    assert np.allclose(moved, expected, rtol=0, atol=1e-6 * np.max(np.abs(expected)))
    assert np.max(np.abs(moved)) > 1e-3


@pytest.mark.parametrize("solve", [ordinary_least_squares, weighted_least_squares])
def test_all_gains_too_high_make_all_parameters_too_high(recording, solve):
    found = identify([recording], [], IdentifyChoices(search_delay=False))
    active = [column for column in found.solution.active if column != 2]
    solution = solve(found.reduction, active)
    sensitivity = gain_sensitivity(found.reduction, solution)
    assert sensitivity.sum(axis=1) == pytest.approx(solution.parameters, rel=1e-6, abs=1e-9)
    assert not sensitivity[2].any()


def test_the_energy_has_no_rows_of_a_joint(recording):
    found = identify([recording], [], IdentifyChoices(search_delay=False))
    with pytest.raises(UsageError, match="no single joint"):
        gain_sensitivity(found.reduction, replace(found.solution, weights=np.ones(1)))


def test_uncertainty_is_that_of_the_robot_file(three_joint):
    robot, panda = three_joint.robot, load_robot("panda").robot
    assert relative_gain_std(robot, robot.joint_names) == pytest.approx([0.05, 0.0625, 0.05])
    assert relative_gain_std(robot, ("j2",)) == pytest.approx([0.0, 0.0625, 0.0])
    assert not relative_gain_std(panda, panda.joint_names).any()


def test_moves_by_chance_add_nothing_on_average() -> None:
    """An unbiased estimate of a bias' square, but for what is cut at 0."""
    generator = np.random.default_rng(0)
    variance, bias = np.full(100_000, 4.0), 6.0
    moved = bias + generator.normal(0.0, 2.0, variance.shape)
    assert np.mean(np.square(beyond_chance(moved, variance))) == pytest.approx(bias**2, rel=0.02)
    by_chance = beyond_chance(moved - bias, variance)
    assert np.mean(np.square(by_chance)) < 0.5 * 4.0
    assert np.all(beyond_chance(moved, np.zeros_like(moved)) == pytest.approx(moved))
