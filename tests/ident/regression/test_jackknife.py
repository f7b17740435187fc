"""The jackknife against what it stands for: leaving blocks out, and the spread over many noises."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ident.regression.jackknife
from daq.robot.loader import RobotFile, parse_robot
from drivers.core.errors import IdentificationError
from ident.identify.identification import IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.regressor import RegressorKernel, regressor
from ident.model.true_parameters import truth_vector
from ident.regression.comparison import TorqueSeries, compare_torques
from ident.regression.jackknife import (
    FEWEST_BLOCKS,
    MOST_BLOCKS,
    BlockSums,
    CorrectedCovariance,
    FilteredRun,
    block_jackknife,
    block_length,
    delete_block_moves,
    jackknife_covariance,
    least_squares_moves,
    residual_autocorrelation,
    tolerant_moves,
)
from ident.regression.least_squares import LeastSquares, excited_columns, ordinary_least_squares, weighted_least_squares
from ident.regression.observation_matrix import reduce_segments
from ident.signals.filters import no_filter
from ident.signals.pipeline import Segment
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording

pytestmark = pytest.mark.usefixtures("estimates_alone", "stated_friction")


def corrected_covariance(
    model: DynamicModel, segments: tuple[Segment, ...], method=ordinary_least_squares
) -> tuple[LeastSquares, CorrectedCovariance]:
    columns = base_parameters(model).columns
    kernel = RegressorKernel(model, columns)
    reduction = reduce_segments(kernel, segments, no_filter())
    solution = method(reduction, excited_columns(reduction))
    series = compare_torques(model, columns, solution.parameters, segments, no_filter())
    return solution, block_jackknife(kernel, [FilteredRun(segments, no_filter(), series)], solution)


def ratio(solution: LeastSquares, corrected: CorrectedCovariance) -> np.ndarray:
    return np.sqrt(np.diag(corrected.covariance) / np.diag(solution.covariance))


def autoregressive(shape: tuple[int, int], memory: float, seed: int) -> np.ndarray:
    from scipy.signal import lfilter

    white = np.random.default_rng(seed).standard_normal((shape[0], shape[1] + 200))
    return np.sqrt(1 - memory**2) * lfilter([1.0], [1.0, -memory], white, axis=1)[:, 200:]


@pytest.fixture(scope="module")
def exact(three_joint, smooth_segment) -> tuple[DynamicModel, Segment]:
    model = build_model(three_joint)
    return model, smooth_segment(model, 1500, parameters=truth_vector(three_joint))


@pytest.mark.parametrize("method", [ordinary_least_squares, weighted_least_squares])
def test_it_is_the_jackknife_done_by_hand(exact, method):
    """C = (B − 1)/B Σ (θ_without b − θ)(…)ᵀ with each block really left out of the full system."""
    model, segment = exact
    columns = base_parameters(model).columns
    used = np.ones(1500, dtype=bool)
    used[400:520] = False
    torque = segment.torque + autoregressive(segment.torque.shape, 0.6, 1) * np.array([[2.0], [1.0], [0.1]])
    segment = replace(segment, torque=torque, used=used)
    solution, corrected = corrected_covariance(model, (segment,), method)
    W = regressor(model, segment.position, segment.velocity, segment.acceleration, columns)
    W = (solution.weights[:, None, None] * W)[:, :, used]
    measured = (solution.weights[:, None] * torque)[:, used]
    number = np.arange(used.sum()) // corrected.block_length
    assert len(np.unique(number)) == corrected.blocks

    def fit(kept: np.ndarray) -> np.ndarray:
        rows = W[:, :, kept].transpose(0, 2, 1).reshape(-1, W.shape[1])
        return np.linalg.lstsq(rows, measured[:, kept].ravel(), rcond=None)[0]

    everything = fit(np.ones(len(number), dtype=bool))
    moves = np.array([fit(number != block) - everything for block in range(corrected.blocks)])
    expected = (corrected.blocks - 1) / corrected.blocks * moves.T @ moves
    scale = np.sqrt(np.diag(expected))
    assert np.allclose(corrected.covariance / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_white_noise_needs_no_correction(exact, seed):
    model, segment = exact
    noise = np.random.default_rng(seed).standard_normal(segment.torque.shape)
    solution, corrected = corrected_covariance(model, (replace(segment, torque=segment.torque + noise),))
    assert 0.75 < np.median(ratio(solution, corrected)) < 1.3
    assert np.all(np.abs(corrected.autocorrelation) < 0.1)
    assert 0.8 * solution.rows < corrected.effective_rows <= solution.rows
    assert corrected.repetitions == 1.0


def test_correlated_noise_deceives_the_classical_covariance_and_not_the_jackknife(exact):
    """Empirical spread of the parameters over 40 noises with a memory of ten samples."""
    model, segment = exact
    found, classical, jackknife = [], [], []
    for seed in range(40):
        noise = autoregressive(segment.torque.shape, 0.9, seed)
        solution, corrected = corrected_covariance(model, (replace(segment, torque=segment.torque + noise),))
        found.append(solution.parameters[list(solution.active)])
        classical.append(np.diag(solution.covariance))
        jackknife.append(np.diag(corrected.covariance))
    spread = np.std(found, axis=0, ddof=1)
    assert np.median(np.sqrt(np.mean(classical, axis=0)) / spread) < 0.5
    assert 0.75 < np.median(np.sqrt(np.mean(jackknife, axis=0)) / spread) < 1.3
    assert corrected.effective_rows < 0.2 * solution.rows


def test_unequal_noise_of_the_joints_deceives_ols_alone(exact):
    """White, but ten times larger at the first joints: rows of unequal variance, which OLS takes as equal.

    (At a hundred times the jackknife is on the safe side by a factor of two: what leaves with a block also changes how
    the large residuals of the first joints leak into the parameters of the last. WLS, the default, knows better.)
    """
    model, segment = exact
    base = base_parameters(model)
    place = base.names.index("Fs3")
    found, classical, jackknife = [], [], []
    for seed in range(40):
        noise = np.random.default_rng(seed).standard_normal(segment.torque.shape) * np.array([[3.0], [3.0], [0.3]])
        solution, corrected = corrected_covariance(model, (replace(segment, torque=segment.torque + noise),))
        found.append(solution.parameters[place])
        classical.append(solution.covariance[place, place])
        jackknife.append(corrected.covariance[place, place])
    spread = np.std(found, ddof=1)
    assert np.sqrt(np.mean(classical)) > 1.5 * spread
    assert 0.7 < np.sqrt(np.mean(jackknife)) / spread < 1.4


def test_a_motion_played_twice_is_no_new_evidence_against_an_error_that_repeats(exact, three_joint):
    model, segment = exact
    error = autoregressive(segment.torque.shape, 0.6, 1)
    once = replace(segment, torque=segment.torque + error)
    _, alone = corrected_covariance(model, (once,))
    _, four_times = corrected_covariance(model, (once,) * 4)
    assert four_times.repetitions == 4.0
    assert four_times.blocks == alone.blocks
    assert np.allclose(four_times.covariance, alone.covariance, rtol=1e-6, atol=0)
    assert four_times.effective_rows == pytest.approx(alone.effective_rows, rel=0.01)


def test_a_motion_played_twice_averages_noise(exact):
    model, segment = exact
    generator = np.random.default_rng(0)
    noisy = [replace(segment, torque=segment.torque + generator.standard_normal((3, 1500))) for _ in range(4)]
    _, once = corrected_covariance(model, (noisy[0],))
    _, four_times = corrected_covariance(model, tuple(noisy))
    halved = np.sqrt(np.diag(four_times.covariance) / np.diag(once.covariance))
    assert 0.35 < np.median(halved) < 0.65


@given(rho=st.floats(-0.99, 0.99), samples=st.integers(1, 200_000))
def test_number_of_blocks_stays_between_its_bounds(rho, samples):
    length = block_length(np.array([0.1, rho]), samples)
    blocks = -(-samples // length)
    assert length >= 1
    assert blocks <= MOST_BLOCKS
    assert blocks >= min(samples, FEWEST_BLOCKS)


@given(samples=st.integers(1, 100_000), rho=st.tuples(st.floats(0, 0.99), st.floats(0, 0.99)))
def test_longer_memory_makes_longer_blocks(samples, rho):
    shorter, longer = (block_length(np.array([value]), samples) for value in sorted(rho))
    assert shorter <= longer


def test_autocorrelation_of_each_joint():
    residual = np.vstack([autoregressive((1, 20_000), memory, 3) for memory in (0.0, 0.5, 0.9, -0.7)])
    residual = np.vstack([residual, np.zeros(20_000)])
    still = np.zeros_like(residual)
    series = TorqueSeries(np.arange(20_000.0), residual, still, still, np.ones(20_000, dtype=bool))
    assert np.allclose(residual_autocorrelation([series]), [0.0, 0.5, 0.9, -0.7, 0.0], atol=0.03)


RIPPLE = """
  noise:
    rate: 100
    torque_std: {j1: 0.05, j2: 0.05, j3: 0.02}
    ripple_amplitude: {j1: 2.0, j2: 2.0, j3: 0.5}
    ripple_per_revolution: 9
"""


PLAIN = ModelChoices(friction="coulomb-viscous")


def test_coverage_stays_with_an_error_that_repeats_with_the_motion(three_joint, monkeypatch):
    """Ripple comes back the same in each of four periods: whoever counts them as four is too sure of himself."""
    text = three_joint.text[: three_joint.text.index("  noise:")] + RIPPLE.lstrip("\n")
    robot: RobotFile = parse_robot(text, where="rippled", folder=None)
    model = build_model(robot)
    base = base_parameters(model)
    truth = base.projection @ truth_vector(robot)
    known, ignored = [], []
    for seed in range(6):
        motion = random_fourier_motion(model, 10.0, seed, candidates=3)
        recording = simulate_recording(robot, motion, 45.0, seed, rate=100.0)
        choices = IdentifyChoices(split=40.0, search_delay=False, presliding=False, model=PLAIN)
        found = identify([recording], [], choices)
        assert found.corrected.repetitions == pytest.approx(4.0, abs=0.3)
        error = np.abs(found.solution.parameters - truth)
        known.append(error <= 1.96 * found.std)
        with monkeypatch.context() as context:
            context.setattr(
                ident.regression.jackknife,
                "motion_phases",
                lambda velocities: tuple(np.arange(v.shape[1]) for v in velocities),
            )
            unaware = identify([recording], [], choices)
        ignored.append(error <= 1.96 * unaware.std)
    assert 0.88 <= np.mean(known) <= 0.99
    assert np.mean(ignored) < np.mean(known) - 0.05


ROWS, PARAMETERS, BLOCKS = 400, 5, 20


@pytest.fixture(scope="module")
def grams() -> np.ndarray:
    """(B, a + 1, a + 1) Gram matrices of [W y] of consecutive rows."""
    generator = np.random.default_rng(0)
    system = generator.standard_normal((ROWS, PARAMETERS)) * np.array([1e-3, 1.0, 10.0, 1.0, 1e3])
    wide = np.column_stack([system, system @ np.ones(PARAMETERS) + generator.standard_normal(ROWS)])
    return np.array([rows.T @ rows for rows in np.split(wide, BLOCKS)])


def solved(gram: np.ndarray) -> np.ndarray:
    return np.linalg.solve(gram[:-1, :-1], gram[:-1, -1])


def sums_of(grams: np.ndarray) -> BlockSums:
    whole = solved(grams.sum(axis=0))
    return BlockSums(grams[:, :-1, :-1], grams[:, :-1, -1] - grams[:, :-1, :-1] @ whole)


def test_leverage_gives_what_estimating_again_gives(grams: np.ndarray) -> None:
    sums = sums_of(grams)
    by_leverage = least_squares_moves(sums, sums.gram.sum(axis=0))
    again = delete_block_moves(solved, grams)
    scale = np.abs(again).max(axis=0)
    np.testing.assert_allclose(by_leverage / scale, again / scale, atol=1e-6)
    np.testing.assert_allclose(tolerant_moves(sums, sums.gram.sum(axis=0)) / scale, again / scale, atol=1e-6)
    expected = (BLOCKS - 1) / BLOCKS * again.T @ again
    pairs = np.outer(scale, scale)
    np.testing.assert_allclose(jackknife_covariance(by_leverage) / pairs, expected / pairs, atol=1e-5)


def test_a_parameter_that_one_block_alone_determines(grams: np.ndarray) -> None:
    alone = grams.copy()
    alone[1:, 0, :] = alone[1:, :, 0] = 0.0
    sums = sums_of(alone)
    normal = sums.gram.sum(axis=0)
    with pytest.raises(IdentificationError, match="single short part of the motion determines a parameter"):
        least_squares_moves(sums, normal)
    with pytest.raises(IdentificationError, match="single short part of the motion determines a parameter"):
        delete_block_moves(solved, alone)
    assert np.all(np.isfinite(tolerant_moves(sums, normal)))
