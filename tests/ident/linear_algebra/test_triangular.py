"""Triangular factors: the same normal matrix whatever the blocks, and the digits that each way keeps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ident.linear_algebra.triangular import GramAccumulator, QrAccumulator, scaled_condition, triangular

KINDS = (GramAccumulator, QrAccumulator)


def split(rows: np.ndarray, cuts: list[int]) -> list[np.ndarray]:
    return np.split(rows, sorted(cut % (len(rows) + 1) for cut in cuts))


@pytest.mark.parametrize("kind", KINDS)
@settings(deadline=None, max_examples=60)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(0, 60),
    width=st.integers(1, 8),
    rank=st.integers(1, 8),
    cuts=st.lists(st.integers(0, 60), max_size=6),
)
def test_factor_has_the_normal_matrix_for_any_partition_and_rank(kind, seed, count, width, rank, cuts):
    generator = np.random.default_rng(seed)
    matrix = generator.standard_normal((count, min(rank, width))) @ generator.standard_normal((min(rank, width), width))
    matrix *= 10.0 ** generator.uniform(-3, 3, width)
    matrix[:, generator.random(width) < 0.1] = 0.0
    accumulator = kind(width)
    for part in split(matrix, cuts):
        accumulator.add(part.T)
    factor = accumulator.factor()
    assert accumulator.rows == count
    assert factor.shape == (width, width)
    assert np.array_equal(factor, np.triu(factor))
    lengths = np.linalg.norm(matrix, axis=0)
    difference = factor.T @ factor - matrix.T @ matrix
    assert np.all(np.abs(difference) <= 1e-12 * np.outer(lengths, lengths) * max(1, count))


def badly_conditioned(condition: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """W (2000, 10) of unit columns, known parameters, and exact torques."""
    generator = np.random.default_rng(seed)
    left = np.linalg.qr(generator.standard_normal((2000, 10)))[0]
    right = np.linalg.qr(generator.standard_normal((10, 10)))[0]
    W = left * np.geomspace(1.0, 1.0 / condition, 10) @ right.T
    W /= np.linalg.norm(W, axis=0)
    parameters = generator.standard_normal(10)
    return W, parameters, W @ parameters


def accumulated_error(kind, W: np.ndarray, parameters: np.ndarray, torque: np.ndarray) -> float:
    accumulator = kind(11)
    for part in np.array_split(np.column_stack([W, torque]), 17):
        accumulator.add(part.T)
    factor = accumulator.factor()
    solution = np.linalg.lstsq(factor[:, :10], factor[:, 10], rcond=None)[0]
    return float(np.linalg.norm(solution - parameters) / np.linalg.norm(parameters))


def test_qr_keeps_the_digits_of_lstsq_at_condition_1e6_where_the_gram_matrix_does_not():
    W, parameters, torque = badly_conditioned(1e6)
    direct = np.linalg.lstsq(W, torque, rcond=None)[0]
    least = float(np.linalg.norm(direct - parameters) / np.linalg.norm(parameters))
    qr = accumulated_error(QrAccumulator, W, parameters, torque)
    gram = accumulated_error(GramAccumulator, W, parameters, torque)
    assert qr < 10 * max(least, 1e-11)
    assert gram > 100 * qr


def test_gram_matrix_is_good_enough_at_the_condition_up_to_which_it_is_used():
    assert accumulated_error(GramAccumulator, *badly_conditioned(1e4)) < 1e-6


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 12), width=st.integers(1, 8))
def test_triangular_is_square_however_few_rows(seed, count, width):
    matrix = np.random.default_rng(seed).standard_normal((count, width))
    factor = triangular(matrix)
    assert factor.shape == (width, width)
    assert np.array_equal(factor, np.triu(factor))
    assert np.allclose(factor.T @ factor, matrix.T @ matrix, rtol=0, atol=1e-12)


def test_scaled_condition_does_not_depend_on_units():
    matrix = np.random.default_rng(1).standard_normal((30, 6))
    plain = scaled_condition(matrix)
    assert scaled_condition(matrix * np.geomspace(1e-6, 1e6, 6)) == pytest.approx(plain, rel=1e-9)
    assert scaled_condition(np.eye(4)) == pytest.approx(1.0)


def test_scaled_condition_of_a_missing_column_is_infinite():
    matrix = np.random.default_rng(1).standard_normal((30, 6))
    matrix[:, 2] = 0.0
    assert scaled_condition(matrix) == np.inf
    assert scaled_condition(np.empty((0, 3))) == np.inf
