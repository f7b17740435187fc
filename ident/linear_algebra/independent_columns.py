"""Independent columns of a matrix, in an order of preference."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from drivers.core.arrays import FloatArray


def independent_columns(matrix: FloatArray, order: Iterable[int], tolerance: float) -> list[int]:
    """Columns that are linearly independent of those kept before them.

    Gram-Schmidt, every column twice: one pass leaves a component along nearly
    dependent columns.

    Args:
        matrix: (m, n); columns of different units must be normalised first.
        order: indices of the candidate columns, the preferred ones first.
        tolerance: length of the independent component up to which a column is dependent.

    Returns:
        Indices of the kept columns, in the given order.
    """
    basis = np.empty((matrix.shape[0], 0))
    kept: list[int] = []
    for index in order:
        column = matrix[:, index]
        for _ in range(2):
            column = column - basis @ (basis.T @ column)
        length = float(np.linalg.norm(column))
        if length > tolerance:
            basis = np.column_stack([basis, column / length])
            kept.append(index)
    return kept
