"""Covariance of least-squares parameters when the residuals are not white.

The classical covariance σ²(WᵀW)⁻¹ (SR400 eq. 14) takes every row as independent and of the same variance. Filtered
torques are not, nor are ripple, friction and model errors, and a fit takes more out of its residual in the motion's own
band than elsewhere: the error bars come out too small. Here they come from the delete-block jackknife (Künsch, Annals
of Statistics 17, 1989): leave out one block of consecutive samples after the other, all joints together, and see how
far the parameters move,

    C = (B − 1)/B · Σ_b δ_b δ_bᵀ,   δ_b = (WᵀW − W_bᵀW_b)⁻¹ W_bᵀ ρ_b

Blocks longer than the residuals' memory make it insensitive to correlation, also between joints; leaving the block out
of the normal matrix accounts for its leverage. Samples of the same phase of a repeated motion belong to the same block
(`ident.signals.repetition`). It costs one more pass over the data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from drivers.streams import FloatArray
from ident.model.regressor import RegressorKernel
from ident.regression.autocorrelation import independent_share, residual_autocorrelation
from ident.regression.comparison import TorqueSeries
from ident.regression.least_squares import LeastSquares
from ident.regression.observation_matrix import filtered_blocks
from ident.signals.filters import ZeroPhaseFilter
from ident.signals.prepared import Segment
from ident.signals.repetition import motion_phases

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
        repetitions: how often the motion was repeated, on average; 1 where it was not.
    """

    covariance: FloatArray
    block_length: int
    blocks: int
    autocorrelation: FloatArray
    effective_rows: float
    repetitions: float


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
    series = [part for run in runs for part in run.series]
    autocorrelation = residual_autocorrelation(series)
    phases = motion_phases([part.velocity for part in series])
    counted = np.concatenate([phase[part.used] for phase, part in zip(phases, series, strict=True)])
    different = np.unique(counted)
    length = block_length(autocorrelation, len(different))
    sums: dict[int, BlockSum] = {}
    remaining = iter(phases)
    for run in runs:
        for segment, part in zip(run.segments, run.series, strict=True):
            # Blocks of different motions never share a number: their phases are disjoint.
            numbers = np.searchsorted(different, next(remaining)) // length
            _add_block_sums(sums, kernel, segment, run.parallel_filter, part, solution, numbers)
    normal = np.asarray(np.linalg.inv(solution.inverse))
    if not np.all(np.diag(normal) > 0.0):  # rounding, where columns are hardly excited
        normal = total_gram(sums)
    covariance = jackknife(sums, normal)
    share = independent_share(autocorrelation[solution.weights > 0])
    new = len(different) / len(counted)
    return CorrectedCovariance(covariance, length, len(sums), autocorrelation, solution.rows * share * new, 1.0 / new)


@dataclass
class BlockSum:
    """W_bᵀW_b (a, a) and W_bᵀρ_b (a,) of one block, weighted."""

    gram: FloatArray
    score: FloatArray


def total_gram(sums: Mapping[int, BlockSum]) -> FloatArray:
    """WᵀW (a, a) of all blocks together."""
    return np.asarray(np.sum([block.gram for block in sums.values()], axis=0))


def jackknife(sums: Mapping[int, BlockSum], normal: FloatArray) -> FloatArray:
    """Covariance (a, a) of a solution's active parameters from the sums of all its blocks and WᵀW (a, a)."""
    scale = np.sqrt(np.diag(normal))
    scaled_normal = normal / np.outer(scale, scale)
    blocks = len(sums)
    total = np.zeros_like(normal)
    for block in sums.values():
        moved = _move(scaled_normal - block.gram / np.outer(scale, scale), block.score / scale)
        total += np.outer(moved, moved)
    return np.asarray((blocks - 1) / blocks * total / np.outer(scale, scale))


def _move(rest: FloatArray, score: FloatArray) -> FloatArray:
    """By how much the scaled parameters move without a block; very far where the rest cannot determine them."""
    try:
        return np.asarray(np.linalg.solve(rest, score))
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.pinv(rest, rcond=1e-14, hermitian=True) @ score)


def block_length(autocorrelation: FloatArray, samples: int) -> int:
    """Samples a block: the kernel width that Andrews advises for AR(1) residuals (Econometrica 59, 1991, eq. 6.4).

    Within `FEWEST_BLOCKS` and `MOST_BLOCKS` of them.
    """
    rho = float(np.max(np.abs(autocorrelation), initial=0.0))
    alpha = 4.0 * rho**2 / ((1.0 - rho) ** 2 * (1.0 + rho) ** 2)
    width = np.ceil(1.1447 * (alpha * samples) ** (1.0 / 3.0))
    return max(1, int(np.clip(width, np.ceil(samples / MOST_BLOCKS), max(1, samples // FEWEST_BLOCKS))))


def _add_block_sums(
    sums: dict[int, BlockSum],
    kernel: RegressorKernel,
    segment: Segment,
    parallel_filter: ZeroPhaseFilter,
    series: TorqueSeries,
    solution: LeastSquares,
    numbers: npt.NDArray[np.int64],
) -> None:
    """Add one segment's samples to the blocks that `numbers` (M,) says they belong to."""
    size = len(solution.active)
    place = {column: position for position, column in enumerate(solution.active)}
    # Which packed rows belong to active columns, and to which of them.
    chosen = []
    for rows in kernel.joint_rows:
        pairs = [(rows.rows.start + i, place[column]) for i, column in enumerate(rows.columns) if column in place]
        chosen.append(([row for row, _ in pairs], np.array([column for _, column in pairs], dtype=int)))
    position = 0
    nothing = np.empty((0, segment.torque.shape[1]))
    for filtered in filtered_blocks(kernel, segment, parallel_filter, nothing):
        whole = slice(position, position + len(filtered.used))
        position = whole.stop
        residual = series.residual[:, whole][:, filtered.used]
        regressor = filtered.regressor[:, filtered.used]
        number = numbers[whole][filtered.used]
        edges = np.concatenate([[0], np.flatnonzero(np.diff(number)) + 1, [len(number)]])
        for start, stop in pairwise(edges.tolist()):
            if start == stop:
                continue
            block = sums.setdefault(int(number[start]), BlockSum(np.zeros((size, size)), np.zeros(size)))
            for joint, (packed_rows, columns) in enumerate(chosen):
                rows = solution.weights[joint] * regressor[packed_rows, start:stop]
                block.gram[columns[:, None], columns] += rows @ rows.T
                block.score[columns] += rows @ (solution.weights[joint] * residual[joint, start:stop])
