"""Which of dependent columns are kept."""

from __future__ import annotations

import numpy as np
from each import each
from hypothesis import given
from hypothesis import strategies as st

from ident.linear_algebra.independent_columns import DETERMINED, independent_columns, row_space

TOLERANCE = 1e-9


@given(seed=st.integers(0, 2**32 - 1), rank=st.integers(0, 5), columns=st.integers(0, 9))
def test_as_many_as_the_rank_and_all_others_depend_on_those_before(seed, rank, columns):
    generator = np.random.default_rng(seed)
    matrix = generator.standard_normal((7, rank)) @ generator.integers(-2, 3, (rank, columns))
    order = generator.permutation(columns).tolist()
    kept = independent_columns(matrix, order, TOLERANCE)
    assert len(kept) == (np.linalg.matrix_rank(matrix, tol=1e-6) if columns else 0)
    assert kept == sorted(kept, key=order.index)
    for place, number in enumerate(order):
        before = [other for other in kept if order.index(other) < place]
        grows = np.linalg.matrix_rank(matrix[:, [*before, number]], tol=1e-6) > len(before)
        assert (number in kept) == grows


def test_the_order_decides_which_of_equals_is_kept():
    matrix = np.array([[1.0, 2.0, 0.0], [0.0, 0.0, 3.0]])
    assert independent_columns(matrix, [0, 1, 2], TOLERANCE) == [0, 2]
    assert independent_columns(matrix, [2, 1, 0], TOLERANCE) == [2, 1]


def test_columns_that_are_not_in_the_order_are_left_out():
    assert independent_columns(np.eye(4), [3, 1], TOLERANCE) == [3, 1]


def test_the_tolerance_is_a_length():
    matrix = np.array([[1.0, 1.0], [0.0, 1e-3]])
    assert independent_columns(matrix, [0, 1], 1.1e-3) == [0]
    assert independent_columns(matrix, [0, 1], 0.9e-3) == [0, 1]
    assert independent_columns(100.0 * matrix, [0, 1], 1.1e-3) == [0, 1]


@each("distance", [1e-3, 1e-5, 1e-7])
def test_kept_columns_that_are_nearly_parallel_make_no_others_independent(distance):
    # Läuchli's columns: what one pass leaves of the dependent ones is the rounding error divided by the distance.
    nearly = np.vstack([np.ones(6), distance * np.eye(6)])
    dependent = nearly @ np.random.default_rng(0).standard_normal((6, 6))
    assert independent_columns(np.hstack([nearly, dependent]), range(12), 1e-13) == [0, 1, 2, 3, 4, 5]


@given(seed=st.integers(0, 2**32 - 1))
def test_what_is_determined_does_not_depend_on_units(seed: int) -> None:
    generator = np.random.default_rng(seed)
    system = generator.normal(size=(4, 4)) @ generator.integers(-1, 2, size=(4, 7))
    found, in_units = row_space(system), row_space(system * 10.0 ** generator.uniform(-4, 4, 7))
    np.testing.assert_allclose(in_units.shares, found.shares, rtol=0, atol=1e-9)
    rank = np.linalg.matrix_rank(system)
    for column, share in enumerate(found.shares):
        determined = np.linalg.matrix_rank(np.delete(system, column, axis=1)) < rank
        assert determined == (share >= DETERMINED)
