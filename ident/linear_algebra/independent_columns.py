"""Independent columns of a matrix, in an order of preference."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

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


DETERMINED = 1.0 - 1e-6
"""An unknown is determined where this share of it lies in the row space: all of it but rounding."""

SINGULAR = 1e-10
"""Singular values of the normalised system below this share of the largest are rounding."""


@dataclass(frozen=True)
class RowSpace:
    """Row space of a system (m, p) whose columns were divided by their lengths, so that no unit is left in it."""

    lengths: FloatArray  # (p,) of the columns
    singular: FloatArray  # (r,) singular values that are not rounding
    rows: FloatArray  # (r, p) orthonormal rows
    # (p,) of each unknown that lies in the row space, 0 to 1; 1 exactly where the system determines it
    shares: FloatArray


def row_space(system: FloatArray) -> RowSpace:
    """The row space of a system (m, p); unknowns without effect have columns of zeros."""
    lengths = np.linalg.norm(system, axis=0)
    acting = np.flatnonzero(lengths)
    _, singular, directions = np.linalg.svd(system[:, acting] / lengths[acting], full_matrices=False)
    seen = singular > SINGULAR * singular.max(initial=0.0)
    rows = np.zeros((int(seen.sum()), system.shape[1]))
    rows[:, acting] = directions[seen]
    return RowSpace(lengths, singular[seen], rows, np.minimum(np.sum(rows**2, axis=0), 1.0))
