"""What uncertain drive gains make of the base parameters, against robot files with other gains."""

from __future__ import annotations

import numpy as np
import pytest
from each import each

from ident.identify.identification import IdentifyChoices
from ident.identify.identify import identify
from ident.model.dynamic_model import build_model
from ident.regression.systematic_errors import gain_covariances, gain_deviations
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording

pytestmark = pytest.mark.usefixtures("estimates_alone", "stated_friction")


@pytest.fixture(scope="module")
def recording(three_joint):
    motion = random_fourier_motion(build_model(three_joint), 6.0, seed=4)
    return simulate_recording(three_joint, motion, 9.0, seed=4)


def test_it_is_what_other_gains_do(three_joint, recording):
    choices = IdentifyChoices("wls", search_delay=False)
    found = identify([recording], [], choices)
    moves = []
    for joint in range(3):
        drives = list(three_joint.robot.drives)
        share = drives[joint].gain_std / abs(drives[joint].gain)
        step = 1e-3
        drives[joint] = drives[joint].model_copy(update={"gain": drives[joint].gain * (1 + step)})
        other = three_joint.model_copy(update={"robot": three_joint.robot.model_copy(update={"drives": tuple(drives)})})
        changed = identify([recording], [], choices, other)
        moves.append(share * (changed.solution.parameters - found.solution.parameters) / step)
    expected = np.maximum(np.linalg.norm(moves, axis=0), np.abs(np.sum(moves, axis=0)))
    result = found.result
    stated = np.array([parameter.gain_std for parameter in result.base_parameters])
    assert stated == pytest.approx(expected, rel=0.02, abs=1e-3 * expected.max())


def test_a_method_without_equations_of_joints_has_none(recording):
    result = identify([recording], [], IdentifyChoices("energy", search_delay=False)).result
    assert {parameter.gain_std for parameter in result.base_parameters} == {None}


@each("seed", range(5))
@each("correlation", [0.0, 0.3, 0.7, 1.0])
def test_the_larger_extreme_covers_every_correlation(seed, correlation):
    moves = np.random.default_rng(seed).standard_normal((6, 4))
    covariance = (1.0 - correlation) * np.eye(6) + correlation
    spread = np.sqrt(np.diag(moves.T @ covariance @ moves))
    assert np.all(spread <= gain_deviations(moves) * (1 + 1e-12))
    largest = np.sqrt(np.maximum(*(np.diag(of_extreme) for of_extreme in gain_covariances(moves))))
    assert gain_deviations(moves) == pytest.approx(largest)
