"""Covariance of least-squares parameters when the residuals are not white.

The classical covariance σ²(WᵀW)⁻¹ (SR400 eq. 14) takes every row as independent and of the same variance. Filtered
torques are not, nor are ripple, friction and model errors, and a fit takes more out of its residual in the motion's own
band than elsewhere: the error bars come out too small. Here they come from the delete-block jackknife (Künsch, Annals
of Statistics 17, 1989): leave out one block of consecutive samples after the other, all joints together, and see how
far the parameters move,

    C = (B − 1)/B · Σ_b δ_b δ_bᵀ,   δ_b = (WᵀW − W_bᵀW_b)⁻¹ W_bᵀ ρ_b

Blocks longer than the residuals' memory make it insensitive to correlation, also between joints; leaving the block out
of the normal matrix accounts for its leverage. It costs one more pass over the data.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ident.comparison import TorqueSeries
from ident.filters import ZeroPhaseFilter
from ident.kinematics import FloatArray
from ident.least_squares import LeastSquares
from ident.observation import filtered_blocks
from ident.preprocess import Segment
from ident.regressor import RegressorKernel

FEWEST_BLOCKS = 30
MOST_BLOCKS = 300
"""Fewer blocks make the error bars themselves uncertain; more only cost time."""


@dataclass(frozen=True)
class CorrectedCovariance:
    """Jackknife covariance of the active parameters.

    Attributes:
        covariance: (a, a); inf on the diagonal where one block alone determines a parameter.
        block_length: samples a block, after filtering.
        blocks: number of blocks B.
        autocorrelation: (n,) lag-one autocorrelation of each joint's residual.
        effective_rows: number of independent rows that the residuals are worth.
    """

    covariance: FloatArray
    block_length: int
    blocks: int
    autocorrelation: FloatArray
    effective_rows: float


@dataclass(frozen=True)
class FilteredRun:
    """One recording as the estimator saw it: its segments, their parallel filter, and the torques compared."""

    segments: tuple[Segment, ...]
    parallel_filter: ZeroPhaseFilter
    series: tuple[TorqueSeries, ...]


def block_jackknife(
    kernel: RegressorKernel, runs: Sequence[FilteredRun], solution: LeastSquares
) -> CorrectedCovariance:
    """Corrected covariance of a solution's active parameters."""
    autocorrelation = residual_autocorrelation([series for run in runs for series in run.series])
    samples = sum(int(series.used.sum()) for run in runs for series in run.series)
    length = block_length(autocorrelation, samples)
    normal = np.linalg.inv(solution.inverse)
    scale = np.sqrt(np.diag(normal))
    scaled_normal = normal / np.outer(scale, scale)
    total = np.zeros_like(normal)
    blocks = 0
    for run in runs:
        for segment, series in zip(run.segments, run.series, strict=True):
            for gram, score in _block_sums(kernel, segment, run.parallel_filter, series, solution, length):
                moved = _move(scaled_normal - gram / np.outer(scale, scale), score / scale)
                total += np.outer(moved, moved)
                blocks += 1
    covariance = (blocks - 1) / blocks * total / np.outer(scale, scale)
    # AR(1): a sum of N correlated values has the variance of N (1 − ρ)/(1 + ρ) independent ones.
    share = float(np.mean((1.0 - autocorrelation) / (1.0 + autocorrelation)))
    return CorrectedCovariance(covariance, length, blocks, autocorrelation, solution.rows * min(1.0, share))


def _move(rest: FloatArray, score: FloatArray) -> FloatArray:
    """By how much the scaled parameters move without a block; very far where the rest cannot determine them."""
    try:
        return np.asarray(np.linalg.solve(rest, score))
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.pinv(rest, rcond=1e-14, hermitian=True) @ score)


def residual_autocorrelation(series: Sequence[TorqueSeries]) -> FloatArray:
    """Lag-one autocorrelation (n,) of the residuals, within ±0.99."""
    products = sum(np.sum(part.residual[:, 1:] * part.residual[:, :-1], axis=1) for part in series)
    squares = sum(np.sum(part.residual**2, axis=1) for part in series)
    ratio = np.divide(products, squares, out=np.zeros_like(squares), where=np.asarray(squares) > 0)
    return np.asarray(np.clip(ratio, -0.99, 0.99))


def block_length(autocorrelation: FloatArray, samples: int) -> int:
    """Samples a block: the kernel width that Andrews advises for AR(1) residuals (Econometrica 59, 1991, eq. 6.4).

    Within `FEWEST_BLOCKS` and `MOST_BLOCKS` of them.
    """
    rho = float(np.max(np.abs(autocorrelation), initial=0.0))
    alpha = 4.0 * rho**2 / ((1.0 - rho) ** 2 * (1.0 + rho) ** 2)
    width = np.ceil(1.1447 * (alpha * samples) ** (1.0 / 3.0))
    return max(1, int(np.clip(width, np.ceil(samples / MOST_BLOCKS), max(1, samples // FEWEST_BLOCKS))))


def _block_sums(
    kernel: RegressorKernel,
    segment: Segment,
    parallel_filter: ZeroPhaseFilter,
    series: TorqueSeries,
    solution: LeastSquares,
    length: int,
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """For each block of a segment W_bᵀW_b (a, a) and W_bᵀρ_b (a,), weighted."""
    size = len(solution.active)
    place = {column: position for position, column in enumerate(solution.active)}
    # Which packed rows belong to active columns, and to which of them.
    chosen = []
    for rows in kernel.joint_rows:
        pairs = [(rows.rows.start + i, place[column]) for i, column in enumerate(rows.columns) if column in place]
        chosen.append(([row for row, _ in pairs], [column for _, column in pairs]))
    gram, score, filled = np.zeros((size, size)), np.zeros(size), 0
    position = 0
    nothing = np.empty((0, segment.torque.shape[1]))
    for block in filtered_blocks(kernel, segment, parallel_filter, nothing):
        residual = series.residual[:, position : position + len(block.used)][:, block.used]
        position += len(block.used)
        regressor = block.regressor[:, block.used]
        start = 0
        while start < regressor.shape[1]:
            part = slice(start, start + length - filled)
            taken = regressor[:, part]
            for joint, (packed_rows, columns) in enumerate(chosen):
                rows = solution.weights[joint] * taken[packed_rows]
                gram[np.ix_(columns, columns)] += rows @ rows.T
                score[columns] += rows @ (solution.weights[joint] * residual[joint, part])
            filled += taken.shape[1]
            start += taken.shape[1]
            if filled == length:
                yield gram, score
                gram, score, filled = np.zeros((size, size)), np.zeros(size), 0
    if filled:
        yield gram, score
