"""The Gram matrix of preconditioned columns: exact where the plain one is not, and never trusted blindly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from each import each

from benchmarks.arm import arm
from benchmarks.identification.accuracy import problem
from ident.linear_algebra.triangular import GramAccumulator, PreconditionedGram, QrAccumulator, triangular
from ident.regression.least_squares import ordinary_least_squares
from ident.regression.observation_matrix import estimate_condition, reduce_segments
from ident.signals.filters import no_filter

WIDTH = 12
ROWS = 6000
BLOCK = 500


def matrix(condition: float, seed: int) -> np.ndarray:
    """(ROWS, WIDTH) with the given condition, columns then of very different lengths."""
    generator = np.random.default_rng(seed)
    mixing = np.linalg.qr(generator.standard_normal((WIDTH, WIDTH)))[0]
    independent = generator.uniform(-1, 1, (ROWS, WIDTH)) * np.geomspace(1.0, 1.0 / condition, WIDTH)
    return independent @ mixing * 10.0 ** generator.uniform(-3, 3, WIDTH)


def accumulated(accumulator, rows: np.ndarray) -> np.ndarray:
    for start in range(0, len(rows), BLOCK):
        accumulator.add(rows[start : start + BLOCK].T)
    return accumulator.factor()


def preconditioned(rows: np.ndarray, step: int = 10) -> PreconditionedGram:
    return PreconditionedGram(triangular(rows[::step]), len(rows[::step]))


@each("condition", [1e2, 1e5, 1e7])
@each("seed", range(5))
def test_solution_is_as_exact_as_that_of_lstsq(condition, seed):
    rows = matrix(condition, seed)
    truth = np.random.default_rng(seed).standard_normal(WIDTH) / np.linalg.norm(rows, axis=0)
    system = np.column_stack([rows, rows @ truth])
    factor = accumulated(preconditioned(system), system)
    lengths = np.linalg.norm(rows, axis=0)
    found = np.linalg.solve(factor[:WIDTH, :WIDTH] / lengths, factor[:WIDTH, WIDTH])
    reference = np.linalg.lstsq(rows / lengths, system[:, WIDTH], rcond=None)[0]
    scaled_truth = truth * lengths
    floor = np.finfo(float).eps * condition / 10
    assert np.linalg.norm(found - scaled_truth) <= 10 * np.linalg.norm(reference - scaled_truth) + floor


def test_the_plain_gram_matrix_is_not():
    """What the preconditioner is for: the smallest singular value, relative error."""
    rows = matrix(1e7, 0)
    lengths = np.linalg.norm(rows, axis=0)
    exact = triangular(rows / lengths)
    smallest = np.linalg.svd(exact, compute_uv=False)[-1]

    def error(accumulator) -> float:
        found = np.linalg.svd(accumulated(accumulator, rows) / lengths, compute_uv=False)[-1]
        return abs(found - smallest) / smallest

    assert error(preconditioned(rows)) < 1e-9
    assert error(GramAccumulator(WIDTH)) > 1e-6


@pytest.mark.parametrize("zero", [False, True])
def test_dependent_and_zero_columns_are_allowed(zero):
    rows = matrix(1e2, 3)
    rows[:, 5] = 0.0 if zero else rows[:, 2] - 2 * rows[:, 7]
    gram = preconditioned(rows)
    factor = accumulated(gram, rows)
    lengths = np.linalg.norm(rows, axis=0)
    lengths[lengths == 0] = 1.0
    assert gram.sound
    assert gram.rows == ROWS
    scaled, unit = factor / lengths, rows / lengths
    assert np.allclose(scaled.T @ scaled, unit.T @ unit, rtol=0, atol=1e-12)
    assert np.array_equal(factor, np.triu(factor))


def test_a_sample_that_missed_a_column_is_found_out():
    rows = matrix(1e2, 4)
    rows[::10, 3] = rows[::10, 4]  # the sampled rows cannot tell these two apart, the others can
    gram = preconditioned(rows)
    accumulated(gram, rows)
    assert not gram.sound


def test_equals_qr_up_to_signs():
    rows = matrix(1e3, 5)
    one, other = accumulated(preconditioned(rows), rows), accumulated(QrAccumulator(WIDTH), rows)
    signs = np.sign(np.diag(one)) * np.sign(np.diag(other))
    assert np.allclose(one * signs[:, None], other, rtol=0, atol=1e-9 * np.abs(other).max())


def test_a_badly_conditioned_recording_is_reduced_by_it():
    given = problem(arm(), seed=1, samples=5000)
    reduction = reduce_segments(given.kernel, [given.segment], no_filter())
    assert reduction.method.startswith("preconditioned Gram matrix")
    found = ordinary_least_squares(reduction, range(len(given.truth))).parameters
    assert np.linalg.norm(found - given.truth) <= 1e-9 * np.linalg.norm(given.truth)


def test_motion_that_the_sample_missed_sends_the_reduction_through_qr():
    given = problem(arm(), seed=1, samples=5000)
    sampled = np.arange(5000) % 5 == 0
    middle = given.segment.position.mean(axis=1, keepdims=True)
    segment = replace(
        given.segment,
        position=np.where(sampled, given.segment.position, middle + 1e3 * (given.segment.position - middle)),
        velocity=np.where(sampled, given.segment.velocity, 1e3 * given.segment.velocity),
        acceleration=np.where(sampled, given.segment.acceleration, 1e3 * given.segment.acceleration),
    )
    assert estimate_condition(given.kernel, [segment]) == estimate_condition(given.kernel, [given.segment])
    assert reduce_segments(given.kernel, [segment], no_filter()).method.startswith("QR")
