"""Triangular factors of tall matrices that arrive in blocks: R with RᵀR = AᵀA, the matrix itself never stored."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ident.kinematics import FloatArray

GRAM_CONDITION_LIMIT = 1e4
"""Up to this condition (columns scaled) the Gram matrix keeps enough digits; above it, QR of stacked blocks is used."""


class Accumulator(Protocol):
    """Takes blocks (p, m) of a matrix's transposed rows and gives its triangular factor (p, p) at the end."""

    rows: int

    def add(self, block: FloatArray) -> None:
        """Take m more rows."""

    def factor(self) -> FloatArray:
        """R (p, p), upper triangular, of all rows so far."""


class GramAccumulator:
    """Sums AᵀA; the fastest, loses digits with the square of the condition."""

    def __init__(self, width: int) -> None:
        self.rows = 0
        self._gram = np.zeros((width, width))

    def add(self, block: FloatArray) -> None:
        """Take m more rows, as a block (p, m)."""
        self._gram += block @ block.T
        self.rows += block.shape[1]

    def factor(self) -> FloatArray:
        """R (p, p); a singular Gram matrix is allowed."""
        scale = np.sqrt(np.diag(self._gram))
        safe = np.where(scale > 0, scale, 1.0)
        scaled = self._gram / np.outer(safe, safe)
        try:
            root = np.linalg.cholesky(scaled, upper=True)
        except np.linalg.LinAlgError:
            values, vectors = np.linalg.eigh(scaled)
            root = triangular(np.sqrt(np.clip(values, 0.0, None))[:, None] * vectors.T)
        result: FloatArray = root * scale
        return result


class QrAccumulator:
    """QR of the running factor stacked on the next block (TSQR): as accurate as a QR of the whole matrix."""

    def __init__(self, width: int) -> None:
        self.rows = 0
        self._factor = np.zeros((width, width))

    def add(self, block: FloatArray) -> None:
        """Take m more rows, as a block (p, m)."""
        self._factor = triangular(np.vstack([self._factor, block.T]))
        self.rows += block.shape[1]

    def factor(self) -> FloatArray:
        """R (p, p) of all rows so far."""
        return self._factor


def triangular(matrix: FloatArray) -> FloatArray:
    """R (p, p) of a matrix (m, p), filled up with zero rows where m < p."""
    factor = np.asarray(np.linalg.qr(matrix, mode="r"))
    missing = matrix.shape[1] - factor.shape[0]
    return np.vstack([factor, np.zeros((missing, matrix.shape[1]))]) if missing > 0 else factor


def scaled_condition(factor: FloatArray) -> float:
    """Condition number of a factor's columns scaled to unit length; inf where one of them is zero."""
    lengths = np.linalg.norm(factor, axis=0)
    if factor.size == 0 or not np.all(lengths > 0):
        return float("inf")
    singular = np.linalg.svd(factor / lengths, compute_uv=False)
    return float(singular[0] / singular[-1]) if singular[-1] > 0 else float("inf")
