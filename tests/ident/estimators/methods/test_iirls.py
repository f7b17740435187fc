"""I-IRLS: nonlinear friction and load torque by the equations that count."""

from __future__ import annotations

import numpy as np
import pytest
from each import each

from daq.recording.recording import Recording
from daq.robot.loader import RobotFile, parse_robot
from drivers.core.errors import UsageError
from ident.estimators.estimator import Setup
from ident.estimators.robust.friction_bounds import FrictionBounds, friction_bounds
from ident.estimators.robust.reweighting import weighted_pass
from ident.estimators.robust.sensitivities import shape_columns
from ident.estimators.robust.weight_functions import HUBER_THRESHOLD, WeightFunction
from ident.identify.identification import Identification, IdentifyChoices
from ident.identify.identify import identify
from ident.model.dynamic_model import build_model
from ident.model.regressor import LoadTorqueKernel, RegressorKernel, regressor
from ident.model.true_parameters import true_model, truth_vector
from ident.regression.least_squares import ordinary_least_squares
from ident.report import ReportData
from ident.report.sections.convergence import section
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from tests.ident.conftest import THREE_JOINT

pytestmark = pytest.mark.usefixtures("estimates_alone", "stated_friction")

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


@pytest.fixture(scope="module")
def in_turn(faulty) -> Identification:
    return identified(faulty, "iirls:decoupled=true")


def deviations(arm: RobotFile, found: Identification) -> np.ndarray:
    truth = found.base.projection @ truth_vector(arm, true_model(arm))
    return (found.solution.parameters - truth) / found.std


def test_the_truth_lies_within_the_error_bars_in_spite_of_contacts(arm, faulty, full):
    assert full.solution.settled
    assert np.mean(np.abs(deviations(arm, full)) < 1.96) > 0.85
    for motor, truth in enumerate(EXPONENTS):
        sigma = full.shape_std["exponent", motor]
        assert abs(full.model.terms.shape("exponent", motor) - truth) < 3.0 * sigma < 0.15
    random = full.corrected.random_std
    assert random is not None
    assert np.max(full.std[list(full.solution.active)] / random) < 1.5  # a contact is no systematic error
    before = identified(faulty, "irls")  # its shapes are those of all equations
    for motor, truth in enumerate(EXPONENTS):
        assert abs(before.model.terms.shape("exponent", motor) - truth) < 2.0 * before.shape_std["exponent", motor]
    error = [np.abs(np.array(found.model.terms.shapes["exponent"]) - EXPONENTS).max() for found in (before, full)]
    assert error[1] < error[0]


def test_exponents_are_those_of_all_equations_by_hubers_weights(full):
    """No step is left, also by the equations that hard weights rejected; hard ones leave steps of 0.3 to 0.8 % here."""
    estimation, torques, runs = full.estimation, full.experiment.torques, [run.prepared for run in full.runs]
    assert any(np.any(weights == 0.0) for weights in estimation.weights)
    shapes = shape_columns(estimation.kernel, torques)
    values = estimation.solution.parameters
    parameters, huber = np.concatenate([values, np.zeros(3)]), WeightFunction("huber", HUBER_THRESHOLD)
    done = weighted_pass(shapes.kernel, runs, torques, parameters, estimation.joint_covariance, huber)
    along = ordinary_least_squares(done.reduction, [*estimation.solution.active, *shapes.columns])
    for place, motor in zip(shapes.columns, shapes.motors, strict=True):
        step = along.parameters[place] / values[full.base.names.index(f"Fv{motor + 1}")]
        assert abs(step) < 5e-4 * full.model.terms.shape("exponent", motor)


def test_in_turn_comes_to_the_same(full, in_turn):
    assert in_turn.solution.settled
    difference = (in_turn.solution.parameters - full.solution.parameters) / full.std
    assert np.max(np.abs(difference)) < 0.5  # steps shorter than 0.01 σ, and many of them
    assert in_turn.model.terms.shapes["exponent"] == pytest.approx(full.model.terms.shapes["exponent"], abs=5e-3)
    assert in_turn.estimation.passes > full.estimation.passes


def test_every_loop_is_in_the_result_and_on_the_page(faulty, full):
    result = full.result
    assert result.convergence is not None
    names = [loop.name for loop in result.convergence.loops]
    assert names[0].startswith("covariance")
    assert names[1].startswith("weights")
    assert names[2].startswith("friction")
    assert names[-1].startswith("load torque")
    shapes = [loop for loop in result.convergence.loops if loop.name == "exponent α"]
    assert [loop.joint for loop in shapes] == ["j1", "j2", "j3"]
    assert [loop.values[-1] for loop in shapes] == pytest.approx(full.model.terms.shapes["exponent"])
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
    expected = np.sign(states[1][2]) * speed ** kernel.model.terms.shape("exponent", 2) * np.log(speed)
    assert np.allclose(rows[2, base + 1], expected, rtol=1e-6, atol=1e-8)


def test_bounds_that_no_friction_reaches_change_nothing(faulty, full):
    bounded = identified(faulty, "iirls:largest_friction=1")
    assert np.array_equal(bounded.solution.parameters, full.solution.parameters)
    assert "at a bound: none" in bounded.estimation.steps[-1].text


def test_load_friction_that_the_data_have_negative_is_none(arm):
    """f_L of AUBO eq. 16 where the arm has no load friction: noise alone decides its sign."""
    text = arm.text
    for load in ("0.002", "0.003", "0.01"):
        text = text.replace(f"load: {load},", "load: 0,")
    plain = parse_robot(text, where="no load friction", folder=None)
    motion = random_fourier_motion(build_model(plain), 14.0, seed=1)
    recording = simulate_recording(plain, motion, 28.0, seed=1)
    free, found = identified(recording, "irls"), identified(recording, "iirls")
    place = free.base.names.index("Fl3")
    assert free.solution.parameters[place] < 0.0
    assert found.solution.parameters[place] == 0.0
    assert found.estimation.steps[-1].text.endswith("at a bound: Fl3")


@pytest.mark.parametrize("decoupled", ["", ":decoupled=true"])
def test_friction_stays_within_its_bounds(faulty, full, in_turn, decoupled):
    """A bound just below the largest Coulomb friction over its torque limit (AUBO eq. 16)."""
    limits = np.array([joint.torque for joint in full.robot_file.robot.joints])
    unbounded = in_turn if decoupled else full
    free = dict(zip(unbounded.base.names, unbounded.solution.parameters, strict=True))
    share = 0.95 * max(free[f"Fs{k}"] / limit for k, limit in enumerate(limits, start=1))
    found = identified(faulty, f"iirls:largest_friction={share}{decoupled}")
    value = dict(zip(found.base.names, found.solution.parameters, strict=True))
    for k, limit in enumerate(share * limits, start=1):
        assert 0.0 <= value[f"Fs{k}"] <= limit * (1 + 1e-9)
        assert abs(value[f"Fo{k}"]) <= limit * (1 + 1e-9)
        assert value[f"Fv{k}"] >= 0.0
    assert "at a bound: none" not in found.estimation.steps[-1].text


def test_bounds_of_a_term_are_those_of_its_torque(full):
    """At the highest speed and load torque of the data a term reaches its share of the torque limit (eq. 16)."""
    kernel, runs = full.estimation.kernel, tuple(run.prepared for run in full.runs)
    setup = Setup(kernel, full.base, full.experiment, full.robot_file, runs)
    free, tight = friction_bounds(setup, kernel, None), friction_bounds(setup, kernel, 0.1)
    motion = [np.hstack([getattr(s, name) for run in runs for s in run.segments]) for name in ("position", "velocity")]
    speed = np.abs(motion[1][2]).max()
    load = np.abs(LoadTorqueKernel(kernel.model).torque(motion[0])[2]).max()
    limit = 0.1 * full.robot_file.robot.joints[2].torque
    exponent = kernel.model.terms.shape("exponent", 2)
    for name, torque, least in (
        ("Fs3", 1.0, 0.0),
        ("Fo3", 1.0, -limit),
        ("Fv3", speed**exponent, 0),
        ("Fl3", load**2, 0),
    ):
        place = full.base.names.index(name)
        assert tight.most[place] * torque == pytest.approx(limit, rel=1e-3)
        assert tight.least[place] == least
        assert free.most[place] == np.inf
        assert free.least[place] == (-np.inf if least else 0.0)


@each("seed", range(20))
def test_bounded_least_squares_is_the_best_within_the_bounds(dense_reduction, seed):
    """Karush, Kuhn and Tucker: the slope vanishes inside and points outwards at a bound; other columns are free."""
    generator = np.random.default_rng(seed)
    W = generator.standard_normal((60, 6)) * np.array([1.0, 100.0, 0.01, 1.0, 1.0, 3.0])
    torque = W @ (generator.standard_normal(6) / np.array([1.0, 100.0, 0.01, 1.0, 1.0, 3.0]))
    bounds = FrictionBounds(
        np.array([0.0, 0.0, -np.inf, -0.3, 0.0, -np.inf]), np.array([0.5, np.inf, np.inf, 0.3, 0.2, np.inf])
    )
    found = bounds.solution(dense_reduction([(W, torque)]), (0, 1, 2, 3, 4)).parameters
    assert found[5] == 0.0  # not active
    slope = (W.T @ (W @ found - torque) / np.linalg.norm(W, axis=0))[:5]
    for place in range(5):
        if found[place] == bounds.least[place]:
            assert slope[place] > -1e-8
        elif found[place] == bounds.most[place]:
            assert slope[place] < 1e-8
        else:
            assert bounds.least[place] < found[place] < bounds.most[place]
            assert slope[place] == pytest.approx(0.0, abs=1e-7)
    assert set(bounds.reached(found)) == set(np.flatnonzero((found == bounds.least) | (found == bounds.most)))


def test_bounds_and_consistent_parameters_exclude_each_other(faulty):
    with pytest.raises(UsageError, match="exclude each other"):
        identified(faulty, "iirls:consistent=true:largest_friction=1")
