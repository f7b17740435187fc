"""Triangular factors of tall matrices that arrive in blocks: R with RᵀR = AᵀA, the matrix itself never stored."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from drivers.core.arrays import FloatArray

GRAM_CONDITION_LIMIT = 1e4
"""Up to this condition (column-normalised) the plain Gram matrix is accurate enough."""

PRECONDITIONED_CONDITION_LIMIT = 1e8
"""Up to this condition a preconditioned Gram matrix does; above it, and for dependent columns, QR of stacked blocks."""

PRECONDITIONER_FLOOR = 1e-9
"""Singular values of the column-normalised matrix below this are raised to it: a preconditioner must be invertible."""

PRECONDITIONER_GROWTH = 1e3
"""A preconditioned column may be this many times longer than the sampled rows predict."""


SAFE_MARGIN = 1e3
"""Times the least singular value beyond which an estimate of the condition in another norm says that none is below."""

QR_BLOCK = 32
"""Columns that LAPACK's QR works on together."""


class Accumulator(Protocol):
    """Accumulates blocks (p, m) of a matrix's transposed rows into its triangular factor (p, p)."""

    @property
    def rows(self) -> int:
        """Rows added so far."""

    def add(self, block: FloatArray) -> None:
        """Add m more rows."""

    def factor(self) -> FloatArray:
        """R (p, p), upper triangular, of all rows so far."""


class GramAccumulator:
    """Sums AᵀA; the fastest, loses digits with the square of the condition."""

    def __init__(self, width: int) -> None:
        self.rows = 0
        self._gram = np.zeros((width, width))

    def add(self, block: FloatArray) -> None:
        """Add m more rows, as a block (p, m)."""
        self._gram += block @ block.T
        self.rows += block.shape[1]

    @property
    def lengths(self) -> FloatArray:
        """Length (p,) of each column."""
        return np.sqrt(np.diag(self._gram))

    def factor(self) -> FloatArray:
        """R (p, p); a singular Gram matrix is allowed."""
        return gram_root(self._gram)


class PreconditionedGram:
    """Sums (A·X)ᵀ(A·X), X from the factor of some of A's rows, so that A·X is well conditioned where A is not.

    CholeskyQR with a preconditioner: nearly as fast as the Gram matrix, and as accurate as QR of the whole matrix.
    (QR block by block rounds the running factor, whose entries are √m times the rows', once a block.)
    """

    def __init__(self, sampled: FloatArray, sampled_rows: int) -> None:
        """Precondition with the triangular factor (p, p) of `sampled_rows` rows that are spread over the matrix."""
        width = sampled.shape[1]
        lengths = np.linalg.norm(sampled, axis=0)
        lengths = np.where(lengths > 0, lengths, 1.0)
        root = triangular(np.vstack([sampled / lengths, PRECONDITIONER_FLOOR * np.eye(width)]))
        self._preconditioner = np.ascontiguousarray((np.linalg.inv(root) / lengths[:, None]).T)
        self._sampled_rows = sampled_rows
        self._gram = GramAccumulator(width)

    @property
    def rows(self) -> int:
        """Rows added so far."""
        return self._gram.rows

    @property
    def sound(self) -> bool:
        """Whether the sampled rows are representative: no preconditioned column is much longer than they predict."""
        expected = self._gram.rows / self._sampled_rows
        return bool(np.all(self._gram.lengths**2 <= PRECONDITIONER_GROWTH**2 * expected))

    def add(self, block: FloatArray) -> None:
        """Add m more rows, as a block (p, m)."""
        self._gram.add(self._preconditioner @ block)

    def factor(self) -> FloatArray:
        """R (p, p) of all rows so far: R·X is the preconditioned factor."""
        from scipy.linalg import solve_triangular

        preconditioned = self._gram.factor()
        return triangular(solve_triangular(self._preconditioner, preconditioned.T, lower=True).T)


class QrAccumulator:
    """QR of the running factor stacked on the next block (TSQR): slower, but no condition is too high for it."""

    def __init__(self, width: int) -> None:
        self.rows = 0
        self._factor = np.zeros((width, width))

    def add(self, block: FloatArray) -> None:
        """Add m more rows, as a block (p, m)."""
        self._factor = triangular(np.vstack([self._factor, block.T]))
        self.rows += block.shape[1]

    def factor(self) -> FloatArray:
        """R (p, p) of all rows so far."""
        return self._factor


def gram_root(gram: FloatArray) -> FloatArray:
    """R (p, p) with RᵀR of a symmetric matrix (p, p), which may be singular; what is negative in it counts as 0."""
    scale = np.sqrt(np.clip(np.diag(gram), 0.0, None))
    safe = np.where(scale > 0, scale, 1.0)
    scaled = gram / np.outer(safe, safe)
    try:
        root = np.linalg.cholesky(scaled, upper=True)
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(scaled)
        root = triangular(np.sqrt(np.clip(values, 0.0, None))[:, None] * vectors.T)
    return np.asarray(root * scale)


def triangular(matrix: FloatArray) -> FloatArray:
    """R (p, p) of a matrix (m, p), filled up with zero rows where m < p."""
    from scipy.linalg import lapack  # np.linalg.qr, of the same digits, takes up to three times as long on tall ones

    rows, width = matrix.shape
    factor = np.zeros((width, width))
    if matrix.size:
        factor[:rows] = lapack.dgeqrf(matrix, lwork=QR_BLOCK * width)[0][:width]
    return np.triu(factor)


def solved_factor(factor: FloatArray, right: FloatArray, least: float) -> FloatArray:
    """X (p,) of R·x = y for R (k, p) with k ≥ p, y (k,); the shortest one where singular values are below `least`.

    Those of a factor that is far from singular need not be computed, which takes most of the time.
    """
    from scipy.linalg import lapack, solve_triangular

    width = factor.shape[1]
    square = factor[:width]
    if width and lapack.dtrcon(square)[0] > SAFE_MARGIN * least:
        return np.asarray(solve_triangular(square, right[:width], check_finite=False), dtype=np.float64)
    return np.asarray(np.linalg.lstsq(factor, right, rcond=least)[0], dtype=np.float64)


def scaled_condition(factor: FloatArray) -> float:
    """Column-normalised condition number of a factor; inf where one of them is zero."""
    lengths = np.linalg.norm(factor, axis=0)
    if factor.size == 0 or not np.all(lengths > 0):
        return float("inf")
    singular = np.linalg.svd(factor / lengths, compute_uv=False)
    return float(singular[0] / singular[-1]) if singular[-1] > 0 else float("inf")
