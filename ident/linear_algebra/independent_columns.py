"""Which columns of a matrix are kept where some depend on others: those that come first in an order of preference."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from drivers.streams import FloatArray


def independent_columns(matrix: FloatArray, order: Iterable[int], tolerance: float) -> list[int]:
    """Columns with a part of their own, each beside those kept before it.

    Gram-Schmidt, every column twice: after one pass a part along the kept columns is left, the larger the nearer they
    are to dependent.

    Args:
        matrix: (m, n); whoever compares columns of several units scales them first.
        order: numbers of the columns that may be kept, the preferred ones first.
        tolerance: a column whose independent part is no longer than this depends on those kept before it.

    Returns:
        Numbers of the kept columns, in the given order.
    """
    basis = np.empty((matrix.shape[0], 0))
    kept: list[int] = []
    for number in order:
        column = matrix[:, number]
        for _ in range(2):
            column = column - basis @ (basis.T @ column)
        length = float(np.linalg.norm(column))
        if length > tolerance:
            basis = np.column_stack([basis, column / length])
            kept.append(number)
    return kept
