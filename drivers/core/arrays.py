"""Types of NumPy arrays, as annotations have them, shapes standing in the docstrings; runs of true values."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]
IndexArray = npt.NDArray[np.intp]
"""Positions in another array, as `flatnonzero` and `argsort` give them."""


def true_runs(mask: BoolArray) -> list[tuple[int, int]]:
    """First index, and the one after the last, of each run of true values in `mask` (N,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
