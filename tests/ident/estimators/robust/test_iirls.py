"""I-IRLS: nonlinear friction and load torque by the equations that count."""

from __future__ import annotations

import numpy as np
import pytest

from daq.recording.recording import Recording
from daq.robot.loader import RobotFile, parse_robot
from ident.estimators.robust.sensitivities import shape_columns
from ident.identify.identification import Identification, IdentifyChoices
from ident.identify.identify import identify
from ident.identify.summary import summarise
from ident.model.dynamic_model import build_model
from ident.model.regressor import RegressorKernel, regressor
from ident.model.true_parameters import true_model, truth_vector
from ident.report import ReportData
from ident.report.sections.convergence import section
from sim_drivers.synthetic.measurement import simulate_recording
from sim_drivers.synthetic.motion import random_fourier_motion
from tests.ident.conftest import THREE_JOINT

EXPONENTS = (0.6, 0.8, 0.7)


@pytest.fixture(scope="module")
def arm() -> RobotFile:
    text = THREE_JOINT
    for joint, viscous, exponent, load in zip((1, 2, 3), (3, 4, 1), EXPONENTS, (0.002, 0.003, 0.01), strict=True):
        plain = f"j{joint}: {{viscous: {viscous},"
        assert plain in text
        text = text.replace(plain, f"j{joint}: {{alpha: {exponent}, load: {load}, viscous: {viscous},")
    return parse_robot(text + "friction: {exponent: estimated, load: quadratic}\n", where="three_joint", folder=None)


@pytest.fixture(scope="module")
def faulty(arm, with_contacts) -> Recording:
    motion = random_fourier_motion(build_model(arm), 14.0, seed=1)
    return with_contacts(simulate_recording(arm, motion, 28.0, seed=1))


def identified(recording: Recording, method: str) -> Identification:
    return identify([recording], [], IdentifyChoices(method, search_delay=False))


@pytest.fixture(scope="module")
def full(faulty) -> Identification:
    return identified(faulty, "iirls")


def deviations(arm: RobotFile, found: Identification) -> np.ndarray:
    truth = found.base.projection @ truth_vector(arm, true_model(arm))
    return (found.solution.parameters - truth) / found.std


def test_the_truth_lies_within_the_error_bars_in_spite_of_contacts(arm, faulty, full):
    assert full.solution.settled
    assert np.mean(np.abs(deviations(arm, full)) < 1.96) > 0.85
    for motor, truth in enumerate(EXPONENTS):
        sigma = full.shape_std["exponent", motor]
        assert abs(full.model.terms.exponent[motor] - truth) < 3.0 * sigma < 0.15
    before = identified(faulty, "irls")  # its shapes are those of all equations
    error = [np.abs(np.array(found.model.terms.exponent) - EXPONENTS).max() for found in (before, full)]
    assert error[1] < error[0]


def test_in_turn_comes_to_the_same(arm, faulty, full):
    turned = identified(faulty, "iirls:decoupled=true")
    assert turned.solution.settled
    difference = (turned.solution.parameters - full.solution.parameters) / full.std
    assert np.max(np.abs(difference)) < 0.5  # steps shorter than 0.01 σ, and many of them
    assert turned.model.terms.exponent == pytest.approx(full.model.terms.exponent, abs=5e-3)
    assert turned.estimation.passes > full.estimation.passes


def test_every_loop_is_in_the_result_and_on_the_page(faulty, full):
    result = summarise(full, [faulty], [])
    assert result.convergence is not None
    names = [loop.name for loop in result.convergence.loops]
    assert names[0].startswith("covariance")
    assert names[1].startswith("weights")
    assert names[2].startswith("friction")
    assert names[-1].startswith("load torque")
    shapes = [loop for loop in result.convergence.loops if loop.name == "exponent α"]
    assert [loop.joint for loop in shapes] == ["j1", "j2", "j3"]
    assert [loop.values[-1] for loop in shapes] == pytest.approx(full.model.terms.exponent)
    assert all(loop.settled for loop in result.convergence.loops)
    shown = section(ReportData(result, full.fit_series, full.validation_series))
    assert shown is not None
    assert "exponent α" in {trace["meta"]["panel"] for trace in shown.context["figure"].data}


def test_without_nonlinear_friction_it_is_irls(three_joint, with_contacts):
    motion = random_fourier_motion(build_model(three_joint), 10.0, seed=2)
    recording = with_contacts(simulate_recording(three_joint, motion, 20.0, seed=2))
    plain, full = identified(recording, "irls"), identified(recording, "iirls")
    assert np.array_equal(plain.solution.parameters, full.solution.parameters)
    assert plain.estimation.passes == full.estimation.passes


def test_sensitivities_are_derivatives_by_the_shapes(full):
    kernel = full.estimation.kernel
    shapes = shape_columns(kernel, (0, 2))
    assert shapes.motors == (0, 2)
    generator = np.random.default_rng(0)
    states = [generator.uniform(-2.0, 2.0, (3, 600)) for _ in range(3)]
    base = len(kernel.columns)
    rows = regressor(shapes.kernel.model, *states, shapes.kernel.columns)
    assert np.array_equal(rows[:, :base], regressor(kernel.model, *states, kernel.columns))
    assert isinstance(shapes.kernel, RegressorKernel)
    speed = np.abs(states[1][2])
    expected = np.sign(states[1][2]) * speed ** kernel.model.terms.exponent[2] * np.log(speed)
    assert np.allclose(rows[2, base + 1], expected, rtol=1e-6, atol=1e-8)
