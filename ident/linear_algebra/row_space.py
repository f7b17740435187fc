"""Which unknowns a linear system determines, whatever their units: what lies in its row space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray

DETERMINED = 1.0 - 1e-6
"""An unknown is determined where this share of it lies in the row space: all of it but rounding."""

SINGULAR = 1e-10
"""Singular values of the normalised system below this share of the largest are rounding."""


@dataclass(frozen=True)
class RowSpace:
    """Row space of a system (m, p) whose columns were divided by their lengths, so that no unit is left in it.

    Attributes:
        lengths: (p,) of the columns.
        singular: (r,) singular values that are not rounding.
        rows: (r, p) orthonormal rows.
        shares: (p,) of each unknown that lies in the row space, 0 to 1; 1 exactly where the system determines it.
    """

    lengths: FloatArray
    singular: FloatArray
    rows: FloatArray
    shares: FloatArray


def row_space(system: FloatArray) -> RowSpace:
    """The row space of a system (m, p); unknowns without effect have columns of zeros."""
    lengths = np.linalg.norm(system, axis=0)
    acting = np.flatnonzero(lengths)
    _, singular, found = np.linalg.svd(system[:, acting] / lengths[acting], full_matrices=False)
    seen = singular > SINGULAR * singular.max(initial=0.0)
    rows = np.zeros((int(seen.sum()), system.shape[1]))
    rows[:, acting] = found[seen]
    return RowSpace(lengths, singular[seen], rows, np.minimum(np.sum(rows**2, axis=0), 1.0))
