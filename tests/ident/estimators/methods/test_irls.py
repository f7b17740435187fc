"""IRLS against dense algebra, and what it is for: faults in the recording."""

from __future__ import annotations

import numpy as np
import pytest
from each import each

from daq.recording.recording import Recording
from ident.estimators.methods.irls import LEAST_HOLD, loosened
from ident.estimators.robust.reweighting import Pass, RobustFit
from ident.estimators.robust.weight_functions import weight_function
from ident.estimators.robust.whitened_equations import CovarianceSums, Whitening, shrunk
from ident.identify.identification import Identification, IdentifyChoices
from ident.identify.identify import identify
from ident.model.dynamic_model import build_model
from ident.model.regressor import regressor
from ident.model.true_parameters import truth_vector
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.regression.options import ExperimentChoices
from ident.report import ReportData
from ident.report.page import render_report
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording

pytestmark = pytest.mark.usefixtures("estimates_alone", "stated_friction")

METHODS = ("irls", "irls:weights=huber", "irls:weights=tukey", "irls:consistent=true")


@pytest.fixture(scope="module")
def clean(three_joint) -> Recording:
    motion = random_fourier_motion(build_model(three_joint), 15.0, seed=1)
    return simulate_recording(three_joint, motion, 30.0, seed=1)


@pytest.fixture(scope="module")
def faulty(clean, with_contacts) -> Recording:
    return with_contacts(clean)


def identified(recording: Recording, method: str, **choices) -> Identification:
    return identify([recording], [], IdentifyChoices(method, search_delay=False, **choices))


@pytest.fixture(scope="module")
def robust(faulty) -> dict[str, Identification]:
    return {method: identified(faulty, method) for method in METHODS}


@pytest.fixture(scope="module")
def weighted(clean, faulty) -> dict[str, Identification]:
    return {"clean": identified(clean, "wls"), "faulty": identified(faulty, "wls")}


@pytest.mark.parametrize("method", METHODS)
def test_the_estimate_is_least_squares_of_the_whitened_and_weighted_equations(robust, method):
    found = robust[method]
    base = found.base
    prepared = found.runs[0].prepared
    parallel, (segment,) = prepared.parallel_filter, prepared.segments
    rows = regressor(found.model, segment.position, segment.velocity, segment.acceleration, base.columns)
    torque = parallel.apply(segment.torque)
    filtered = np.stack([parallel.apply(np.ascontiguousarray(of_joint)) for of_joint in rows])
    left, right = [], []
    whitening = Whitening(found.estimation.joint_covariance)
    weights = found.estimation.weights[0]
    for sample in range(weights.shape[1]):
        motors = np.flatnonzero(~np.isnan(weights[:, sample]))
        if len(motors) == 0:
            continue
        _, unroot = whitening.roots(tuple(motors.tolist()))
        root_weight = np.sqrt(weights[motors, sample])[:, None]
        left.append(root_weight * (unroot @ filtered[motors, :, sample]))
        right.append(root_weight[:, 0] * (unroot @ torque[motors, sample]))
    expected, *_ = np.linalg.lstsq(np.vstack(left), np.concatenate(right), rcond=None)
    # The covariance is one update newer than the one that whitened the last pass.
    assert np.max(np.abs(expected - found.solution.parameters) / found.solution.std) < 0.02


@pytest.mark.parametrize("method", METHODS)
def test_faults_cost_little(three_joint, robust, weighted, clean, method):
    found, ordinary, reference = robust[method], weighted["faulty"], weighted["clean"]
    truth = found.base.projection @ truth_vector(three_joint)

    def error(of: Identification) -> float:
        return float(np.median(np.abs(of.solution.parameters - truth) / reference.std))

    assert error(found) < 0.7 * error(ordinary)
    assert np.mean(np.abs(found.solution.parameters - truth) <= WITHIN_95_PERCENT * found.std) > 0.85
    assert found.solution.settled
    assert np.all(found.joint_std < ordinary.joint_std)


def test_the_result_counts_what_was_rejected_and_the_page_shows_it(robust, weighted, faulty):
    found = robust["irls"]
    result = found.result
    assert (result.method, result.method_options) == ("irls", {"weights": "hard", "consistent": False})
    assert result.convergence is not None
    weights = np.concatenate(found.estimation.weights, axis=1)
    assert [one.rejected for one in result.convergence.equations] == np.nansum(weights == 0, axis=1).tolist()
    assert sum(one.equations - one.rejected for one in result.convergence.equations) == found.solution.rows
    assert found.estimation.passes == 2 + len(result.convergence.loops[0].values)
    page = render_report(ReportData(result, found.fit_series, found.validation_series))
    assert 'id="convergence"' in page
    assert '"name":"rejected"' in page.replace(" ", "")
    ordinary = weighted["faulty"]
    page = render_report(ReportData(ordinary.result, ordinary.fit_series, ()))
    assert 'id="convergence"' not in page


def test_motors_without_equations_take_no_part(clean):
    found = identified(clean, "irls", experiment=ExperimentChoices(torques_of=("j1", "j3")))
    weights = np.concatenate(found.estimation.weights, axis=1)
    assert np.all(np.isnan(weights[1]))
    assert np.isnan(found.joint_std[1])
    assert found.validation.relative_error < 0.1
    left_out = identified(clean, "irls", reversals=0.3)
    whole = identified(clean, "irls", reversals=0.0)
    assert left_out.solution.rows < 0.9 * whole.solution.rows
    assert np.sum(np.isnan(left_out.estimation.weights[0])) > np.sum(np.isnan(whole.estimation.weights[0]))


@each("name", ["hard", "huber", "tukey"])
def test_the_thresholds_lose_5_percent_on_normal_residuals(name):
    """Efficiency of an M-estimator: E[ψ′]² / E[ψ²]."""
    function = weight_function(name, 1e6)
    z = np.linspace(-10.0, 10.0, 200_001)
    density = np.exp(-0.5 * z**2) / np.exp(-0.5 * z**2).sum()
    psi = z * function(z)
    assert np.sum(density * z * psi) ** 2 / np.sum(density * psi**2) == pytest.approx(0.95, abs=0.005)
    assert np.all(np.diff(function(np.abs(z[z >= 0]))) <= 0)
    assert function(np.zeros(1))[0] == 1.0
    assert np.sum(density * function.slope(z)) == pytest.approx(np.sum(density * z * psi), abs=0.015)  # by parts
    smooth = np.abs(np.abs(z) - function.threshold) > 1e-3
    assert np.gradient(function.loss(z), z)[smooth] == pytest.approx(2.0 * psi[smooth], abs=1e-3)
    assert function.loss(np.array([0.0, 0.01])) == pytest.approx([0.0, 1e-4], rel=1e-4)


def test_a_fit_that_rejects_more_equations_is_not_a_better_one(robust):
    """The spread of the accepted residuals falls with what is rejected; the loss of all of them does not."""
    estimation = robust["irls"].estimation
    function = weight_function("hard", 1e6)
    residuals = np.random.default_rng(0).standard_normal((3, 2000))
    residuals[1, :50] = np.nan  # a motor at rest
    worse = residuals.copy()
    worse[:, ::10] *= 10.0
    worse[:, 1::10] *= 0.5
    spreads, losses = [], []
    for of_all in (residuals, worse):
        weights = np.where(np.isnan(of_all), np.nan, function(of_all))
        done = Pass(estimation.reduction, (weights,), (of_all,), CovarianceSums(3))
        covariance = np.diag(np.nansum(weights * of_all**2, axis=1) / np.nansum(weights, axis=1))
        fit = RobustFit(estimation.kernel, done, estimation.solution, covariance, True)
        spreads.append(fit.spread)
        losses.append(fit.loss(np.eye(3), function))
    assert spreads[1] < spreads[0]
    assert losses[1] > losses[0] == pytest.approx(np.nanmean(function.loss(residuals)))


def test_error_bars_grow_where_the_others_hold_less_up_to_twofold():
    normal, free = np.array([[4.0, 1.0], [1.0, 2.0]]), np.diag([1.0, 0.5])
    assert np.allclose(loosened(normal, normal), np.eye(2))
    assert np.allclose(loosened(normal, 0.8 * normal), np.eye(2) / 0.8)
    assert np.allclose(loosened(normal, normal - free), normal @ np.linalg.inv(normal - free))
    assert np.allclose(loosened(normal, -normal), np.eye(2) / LEAST_HOLD)


def test_roots_whiten_any_set_of_motors():
    generator = np.random.default_rng(0)
    factor = generator.standard_normal((5, 5)) * np.array([[100.0], [30.0], [5.0], [1.0], [0.1]])
    covariance = factor @ factor.T
    whitening = Whitening(covariance)
    for motors in ((0, 1, 2, 3, 4), (0, 4), (3,)):
        root, unroot = whitening.roots(motors)
        part = covariance[np.ix_(motors, motors)]
        assert np.allclose(root @ root, part, rtol=1e-9)
        assert np.allclose(unroot @ part @ unroot, np.eye(len(motors)), atol=1e-6)


def test_chance_correlations_are_shrunk_and_true_ones_stay():
    generator = np.random.default_rng(1)
    white = generator.standard_normal((6, 40))
    true = np.full((6, 6), 0.8) + 0.2 * np.eye(6)
    raw = white @ white.T / 40
    few = shrunk(raw, 40)
    beside = ~np.eye(6, dtype=bool)
    assert np.allclose(np.diag(few), np.diag(raw))
    assert np.all(np.abs(few[beside]) < 0.6 * np.abs(raw[beside]))
    assert np.allclose(shrunk(true, 1e6), true, atol=1e-5)
    rounded = np.array([[1.0, 1e-3], [1e-3, 1e-320]])
    assert np.array_equal(shrunk(rounded, 40), np.diag(np.diag(rounded)))
    assert np.all(np.linalg.eigvalsh(shrunk(white[:, :4] @ white[:, :4].T / 4, 4)) > 0)
