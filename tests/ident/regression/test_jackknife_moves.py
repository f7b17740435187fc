"""Both ways to leave a block out: by leverage for least squares, by estimating again for anything else."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.core.errors import IdentificationError
from ident.regression.jackknife import (
    BlockSums,
    delete_block_moves,
    jackknife_covariance,
    least_squares_moves,
    tolerant_moves,
)

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
    with pytest.raises(IdentificationError, match="alone determines a parameter"):
        least_squares_moves(sums, normal)
    with pytest.raises(IdentificationError, match="alone determines a parameter"):
        delete_block_moves(solved, alone)
    assert np.all(np.isfinite(tolerant_moves(sums, normal)))
