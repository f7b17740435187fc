"""Null vector of a concatenated system by total least squares, where only some of its columns carry noise.

Row block j says g_j·y_j = A_j·z: an unknown factor g_j for each measured signal y_j, unknowns z that the blocks share,
the last of which is known to be 1. The columns A are taken as exact and eliminated by QR; of what is left of the
signals, scaled so that their noise is the same, the smallest singular vector gives g (mixed LS-TLS: Golub, Hoffman and
Stewart, Linear Algebra and its Applications 88, 1987; with all columns alike, for drive gains: Gautier and Briot 2011,
2014).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import IdentificationError
from ident.linear_algebra.triangular import triangular
from ident.regression.jackknife import delete_block_moves
from ident.regression.least_squares import RESIDUAL_FLOOR

ITERATIONS = 100
SETTLED_RESIDUAL = 1e-9


@dataclass(frozen=True)
class NullVector:
    """Solution, with the known unknown at 1."""

    factors: FloatArray  # (n,) g
    unknowns: FloatArray  # (a,) z
    # (n,) of the scaled rest of the signals, falling; the last one is about 1 where the model is right
    singular: FloatArray
    weights: FloatArray  # (n,) what each block's rows were multiplied with
    scale: FloatArray  # (n,) what each signal's column was multiplied with

    @property
    def gap(self) -> float:
        """Second-smallest over smallest singular value: how far the null vector stands out (inf for one signal)."""
        if len(self.singular) < 2:
            return float("inf")
        return float(self.singular[-2] / max(self.singular[-1], np.finfo(float).tiny))

    @property
    def condition(self) -> float:
        """Largest over second-smallest singular value."""
        return float(self.singular[0] / self.singular[-2]) if len(self.singular) > 1 else 1.0


def signal_noise(factors: Sequence[FloatArray], rows: FloatArray) -> FloatArray:
    """Standard deviation (n,) of each signal about its own columns, coefficients free in every block.

    Args:
        factors: triangular factors (·, a + 1) of [A_j y_j].
        rows: (n,) how many rows each replaces.
    """
    noise = []
    for factor, count in zip(factors, rows, strict=True):
        columns, signal = factor[:, :-1], factor[:, -1]
        lengths = np.linalg.norm(columns, axis=0)
        acting = lengths > 1e-12 * lengths.max(initial=0.0)
        # Factors hold few rows: the least-norm solution keeps dependent columns from eating the residual.
        solution = np.linalg.lstsq(columns[:, acting] / lengths[acting], signal, rcond=1e-10)
        rest = signal - columns[:, acting] / lengths[acting] @ solution[0]
        deviation = np.linalg.norm(rest) / max(count - int(solution[2]), 1.0) ** 0.5
        noise.append(max(float(deviation), RESIDUAL_FLOOR * float(np.linalg.norm(signal)) / max(count, 1.0) ** 0.5))
    return np.array(noise)


def distinctness(factors: Sequence[FloatArray], rows: FloatArray, noise: FloatArray) -> FloatArray:
    """What no column of A explains of each signal (n,), in its own noise; about 1 where it holds nothing of its factor.

    Takes factors g near 1.
    """
    square, width = _concatenated(factors, 1.0 / noise)
    return np.asarray(np.linalg.norm(square[width:, width:], axis=0) / np.sqrt(rows))


def null_vector(factors: Sequence[FloatArray], rows: FloatArray, noise: FloatArray) -> NullVector:
    """Solve, with each block weighted by the noise that its signal has once multiplied with g_j; iterated.

    Raises:
        IdentificationError: dependent columns, a signal that is zero, or weights that do not settle.
    """
    count = len(factors)
    if not np.all(noise > 0):
        raise IdentificationError(f"signal {int(np.argmin(noise)) + 1} is zero throughout", hint="record all motors")
    factor = np.ones(count)
    for _ in range(ITERATIONS):
        weights = 1.0 / (noise * np.abs(factor))
        square, width = _concatenated(factors, weights)
        scale = np.abs(factor) / np.sqrt(rows)
        _, singular, vectors = np.linalg.svd(square[width:, width:] * scale)
        rest = vectors[-1] * scale
        lengths = np.linalg.norm(square[:width, :width], axis=0)
        if not np.all(np.abs(np.diag(square)[:width]) > 1e-9 * lengths):
            raise IdentificationError("the columns of the system are linearly dependent", hint="record a richer motion")
        unknowns = np.linalg.solve(square[:width, :width] / lengths, square[:width, width:] @ rest) / lengths
        refined, unknowns = _normalised(rest, unknowns)
        change = np.max(np.abs(np.abs(refined / factor) - 1.0))
        factor = refined
        if change < SETTLED_RESIDUAL:
            return NullVector(factor, unknowns, singular, weights, scale)
    raise IdentificationError(
        f"the weights of the motor signals did not settle in {ITERATIONS} iterations",
        hint="the motion separates the gains poorly; record longer, or with a heavier load",
    )


def null_vector_of_gram(gram: FloatArray, scale: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Factors (n,) and unknowns (a,) of the weighted Gram matrix (a + n, a + n) of [A Y], scale (n,) as before."""
    width = len(gram) - len(scale)
    lengths = np.sqrt(np.diag(gram))
    scaled = gram / np.outer(lengths, lengths)
    exact, cross = scaled[:width, :width], scaled[:width, width:]
    eliminated = np.linalg.solve(exact, cross)
    size = lengths[width:] * scale
    rest = (scaled[width:, width:] - cross.T @ eliminated) * np.outer(size, size)
    _, vectors = np.linalg.eigh(rest)
    factors = vectors[:, 0] * scale
    return _normalised(factors, (eliminated @ (lengths[width:] * factors)) / lengths[:width])


def null_vector_moves(blocks: FloatArray, solution: NullVector) -> FloatArray:
    """(B, n + a − 1) how far leaving out each block moves factors and unknowns, the known one left out.

    Args:
        blocks: (B, a + n, a + n) weighted Gram matrices of [A Y].
        solution: whose scale is used throughout.

    Raises:
        IdentificationError: without one block the others do not determine an unknown.
    """
    return delete_block_moves(lambda gram: np.concatenate(null_vector_of_gram(gram, solution.scale))[:-1], blocks)


def total_least_squares(factor: FloatArray, errors: FloatArray, torque_error: float) -> tuple[FloatArray, float]:
    """Parameters (a,) and λ of total least squares with known errors of the columns and of the right-hand side.

    Minimises ‖W·θ − τ‖² / (θᵀCθ + c); λ, the minimum, is the share of the errors that the data bear out: about 1 where
    they are as given. C may be singular: columns without errors are exact (mixed LS-TLS).

    Args:
        factor: (a + 1, a + 1) triangular, of [W τ].
        errors: C (a, a) Gram matrix of the columns' errors.
        torque_error: c, sum of the squared errors of τ.

    Raises:
        IdentificationError: dependent columns.
    """
    lengths = np.linalg.norm(factor, axis=0)
    if not np.all(np.abs(np.diag(factor)) > 1e-12 * lengths):
        raise IdentificationError("the columns of the system are linearly dependent", hint="record a richer motion")
    both = np.zeros_like(factor)
    both[:-1, :-1], both[-1, -1] = errors, torque_error
    inverse = np.linalg.solve(factor / lengths, np.eye(len(factor))) / lengths[:, None]
    shares, vectors = np.linalg.eigh(inverse.T @ both @ inverse)
    direction = inverse @ vectors[:, -1]
    return np.asarray(-direction[:-1] / direction[-1]), float(1.0 / shares[-1])


def _concatenated(factors: Sequence[FloatArray], weights: FloatArray) -> tuple[FloatArray, int]:
    """Triangular factor (a + n, a + n) of the weighted [A Y], and a."""
    count, width = len(factors), factors[0].shape[1] - 1
    blocks = []
    for joint_index, factor in enumerate(factors):
        block = np.zeros((factor.shape[0], width + count))
        block[:, :width] = factor[:, :-1]
        block[:, width + joint_index] = factor[:, -1]
        blocks.append(weights[joint_index] * block)
    return triangular(np.vstack(blocks)), width


def _normalised(factors: FloatArray, unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The same direction, with the last unknown at 1."""
    last = unknowns[-1]
    if abs(last) < 1e-12 * float(np.max(np.abs(unknowns))) or last == 0.0:
        raise IdentificationError(
            "the known load does not show in the motor signals, so nothing fixes the size of the gains",
            hint="record with a heavier load, or a motion that moves it more",
        )
    return factors / last, unknowns / last
