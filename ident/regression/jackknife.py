"""Covariance of estimated parameters when the residuals are autocorrelated: the only jackknife there is here.

The classical covariance σ²(WᵀW)⁻¹ (SR400 eq. 14) assumes independent rows of the same variance. Filtered
torques are not, nor are ripple, friction and model errors, and a fit reduces its residual more in the motion's own
band than elsewhere: the error bars are too small. Here they come from the delete-block jackknife (Künsch, Annals
of Statistics 17, 1989): leave out one block of consecutive samples after the other, all joints together, and see how
far the parameters move,

    C = (B − 1)/B · Σ_b δ_b δ_bᵀ

For least squares δ_b = (WᵀW − W_bᵀW_b)⁻¹ W_bᵀ ρ_b (`least_squares_moves`), for any other estimator it is the difference
of two estimates (`delete_block_moves`). Blocks longer than the residuals' memory make it insensitive to correlation,
also between joints; leaving the block out of the normal matrix accounts for its leverage. Samples of the same phase of
a repeated motion belong to the same block (`ident.signals.repetition`). It costs one more pass over the data.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import FloatArray
from drivers.core.errors import IdentificationError
from ident.model.regressor import RegressorKernel
from ident.regression.comparison import TorqueSeries, independent_share, residual_autocorrelation
from ident.regression.least_squares import LeastSquares
from ident.regression.observation_matrix import filtered_samples
from ident.signals.filters import ZeroPhaseFilter
from ident.signals.prepared import Segment
from ident.signals.repetition import motion_phases

FEWEST_BLOCKS = 30
MOST_BLOCKS = 300
"""Fewer blocks make the error bars themselves uncertain; more only cost time."""


@dataclass(frozen=True)
class CorrectedCovariance:
    """Jackknife covariance of the active parameters."""

    covariance: FloatArray  # (a, a); inf on the diagonal where one block alone determines a parameter
    block_length: int  # samples per block, after filtering
    blocks: int  # number of blocks B
    autocorrelation: FloatArray  # (n,) lag-one autocorrelation of each joint's residual
    effective_rows: float  # number of independent rows that the residuals are worth
    repetitions: float  # how often the motion was repeated, on average; 1 where it was not
    # (a,) σ by the jackknife alone, where `covariance` holds more (`systematic_errors`); else None
    random_std: FloatArray | None = None
    # (a,) σ of friction between runs, part of `covariance` (`repeatability`); nan of bodies, None where it is not known
    repeatability: FloatArray | None = None
    # (a, a) covariance without what changes between runs and for the friction's shapes as estimated, where `covariance`
    # holds these, too; else None
    within: FloatArray | None = None
    # (a,) σ that uncertain shapes of friction add beyond the first order, which is all that `covariance` holds; None
    # where nothing was added
    curvature: FloatArray | None = None
    shapes: tuple[tuple[str, int], ...] = ()  # kind and motor of the friction's free shapes (s,)
    # (s, a + s) of these, as parameters of their sensitivities, with the parameters and with each other
    shape_covariance: FloatArray = field(default_factory=lambda: np.empty((0, 0)))


@dataclass(frozen=True)
class FilteredRun:
    """One recording as the estimator saw it: its segments, their parallel filter, and the torques compared."""

    segments: tuple[Segment, ...]
    parallel_filter: ZeroPhaseFilter
    series: tuple[TorqueSeries, ...]


@dataclass(frozen=True)
class DistinctSamples:
    """Filtered samples counted along the motion, repeated phases having the same index."""

    # for each series (M,), without holes over the samples that count; blocks are runs of these indices. Different
    # motions never share an index.
    indices: tuple[npt.NDArray[np.int64], ...]
    count: int  # of different samples that count
    share: float  # of these among all samples that count


@dataclass(frozen=True, eq=False)
class BlockSums:
    """W_bᵀW_b (B, a, a) and W_bᵀρ_b (B, a) of B blocks, weighted."""

    gram: FloatArray
    score: FloatArray

    @classmethod
    def empty(cls, blocks: int, parameters: int) -> BlockSums:
        """Sums of no rows."""
        return cls(np.zeros((blocks, parameters, parameters)), np.zeros((blocks, parameters)))

    def add(self, of_row: npt.NDArray[np.int64], regressor: FloatArray, residual: FloatArray) -> None:
        """Add equations (a, m) and their residuals (m,) to the block (m,) of each."""
        for block in np.unique(of_row).tolist():
            inside = of_row == block
            self.gram[block] += regressor[:, inside] @ regressor[:, inside].T
            self.score[block] += regressor[:, inside] @ residual[inside]

    @property
    def occupied(self) -> BlockSums:
        """Those of blocks with equations."""
        filled = self.gram.any(axis=(1, 2))
        return BlockSums(self.gram[filled], self.score[filled])


@dataclass(frozen=True, eq=False)
class MotionBlocks:
    """The blocks of a motion's filtered samples, as long as the residuals' memory."""

    samples: DistinctSamples  # counted along the motion
    length: int  # of a block [filtered samples]
    autocorrelation: FloatArray  # (n,) of the residuals at lag one

    @property
    def count(self) -> int:
        """Number of blocks."""
        return block_count(self.samples.count, self.length)

    @property
    def of_segments(self) -> tuple[npt.NDArray[np.int64], ...]:
        """The block (M,) of each filtered sample, of each series."""
        return tuple(indices // self.length for indices in self.samples.indices)

    def sums(self, parameters: int) -> BlockSums:
        """Sums of this many parameters, to add equations to."""
        return BlockSums.empty(self.count, parameters)

    def corrected(self, moves: FloatArray, rows: float, share: float) -> CorrectedCovariance:
        """The covariance for how far each block moves the parameters.

        Args:
            moves: (B, a).
            rows: number of equations.
            share: of them, how many independent ones they are worth.
        """
        return CorrectedCovariance(
            covariance=jackknife_covariance(moves),
            block_length=self.length,
            blocks=len(moves),
            autocorrelation=self.autocorrelation,
            effective_rows=rows * share * self.samples.share,
            repetitions=1.0 / self.samples.share,
        )


def motion_blocks(series: Sequence[TorqueSeries], joints: Sequence[int] | None = None) -> MotionBlocks:
    """The blocks of all series, for the residuals of some joints; of all where None."""
    autocorrelation, samples = residual_autocorrelation(series), distinct_samples(series)
    judged = autocorrelation if joints is None else autocorrelation[list(joints)]
    return MotionBlocks(samples, block_length(judged, samples.count), autocorrelation)


def block_jackknife(
    kernel: RegressorKernel, runs: Sequence[FilteredRun], solution: LeastSquares
) -> CorrectedCovariance:
    """Corrected covariance of a solution of the joints' torque equations."""
    blocks = motion_blocks([torques for run in runs for torques in run.series])
    sums, of_segments = blocks.sums(len(solution.active)), iter(blocks.of_segments)
    for run in runs:
        for segment, torques in zip(run.segments, run.series, strict=True):
            rows = rows_by_block(kernel, segment, run.parallel_filter, next(of_segments))
            add_torque_rows(sums, kernel, solution, rows, torques.residual)
    normal = np.asarray(np.linalg.inv(solution.inverse))
    if not np.all(np.diag(normal) > 0.0):  # rounding, where columns are barely excited
        normal = sums.gram.sum(axis=0)
    share = independent_share(blocks.autocorrelation[solution.weights > 0])
    return blocks.corrected(tolerant_moves(sums, normal), solution.rows, share)


def jackknife_covariance(moves: FloatArray) -> FloatArray:
    """Delete-block covariance (a, a) from how far each block moves the parameters (B, a)."""
    return np.asarray((len(moves) - 1) / len(moves) * moves.T @ moves)


def deviation_without(values: FloatArray) -> FloatArray:
    """Standard deviation (…) of an estimate from its values (B, …) without each block."""
    moves = values - values.mean(axis=0)
    return np.asarray(np.sqrt((len(values) - 1) / len(values) * np.sum(np.square(moves), axis=0)))


def least_squares_moves(sums: BlockSums, normal: FloatArray) -> FloatArray:
    """(B, a) how far leaving out each block moves the parameters of a least-squares solution.

    Args:
        sums: of all blocks.
        normal: WᵀW (a, a).

    Raises:
        IdentificationError: without one block the others do not determine a parameter.
    """
    rest, score, scale = _without_each(sums, normal)
    with _undetermined():
        return np.asarray(np.linalg.solve(rest, score[:, :, None])[:, :, 0] / scale)


def delete_block_moves(estimate: Callable[[FloatArray], FloatArray], blocks: FloatArray) -> FloatArray:
    """(B, a) how far leaving out each block moves what `estimate` makes of the sum of the others.

    Args:
        estimate: parameters (a,) from a summed Gram matrix (k, k).
        blocks: (B, k, k) Gram matrix of each block.

    Raises:
        IdentificationError: without one block the others do not determine a parameter.
    """
    total = blocks.sum(axis=0)
    whole = estimate(total)
    with _undetermined():
        return np.array([whole - estimate(total - block) for block in blocks])


@contextmanager
def _undetermined() -> Iterator[None]:
    try:
        yield
    except np.linalg.LinAlgError as error:
        raise IdentificationError(
            "a single short part of the motion determines a parameter", hint="record longer, or a richer motion"
        ) from error


def _without_each(sums: BlockSums, normal: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Normal matrices (B, a, a) without each block and scores (B, a) of it, scaled, and the scale (a,)."""
    scale = np.sqrt(np.diag(normal))
    pairs = np.outer(scale, scale)
    return normal / pairs - sums.gram / pairs, sums.score / scale, scale


def tolerant_moves(sums: BlockSums, normal: FloatArray) -> FloatArray:
    """Moves as `least_squares_moves`; very far, and no error, where the other blocks do not determine a parameter."""

    def move(rest: FloatArray, score: FloatArray) -> FloatArray:
        try:
            return np.asarray(np.linalg.solve(rest, score))
        except np.linalg.LinAlgError:
            return np.asarray(np.linalg.pinv(rest, rcond=1e-14, hermitian=True) @ score)

    rest, scores, scale = _without_each(sums, normal)
    return np.array([move(*block) for block in zip(rest, scores, strict=True)]) / scale


def distinct_samples(series: Sequence[TorqueSeries]) -> DistinctSamples:
    """Count the filtered samples of several series along their motions."""
    phases = motion_phases([torques.velocity for torques in series])
    counted = np.concatenate([phase[torques.used] for phase, torques in zip(phases, series, strict=True)])
    different = np.unique(counted)
    indices = tuple(np.searchsorted(different, phase) for phase in phases)
    return DistinctSamples(indices, len(different), len(different) / len(counted))


def block_length(autocorrelation: FloatArray, samples: int) -> int:
    """Samples per block: the kernel width that Andrews advises for AR(1) residuals (Econometrica 59, 1991, eq. 6.4).

    Within `FEWEST_BLOCKS` and `MOST_BLOCKS` of them.
    """
    rho = float(np.max(np.abs(autocorrelation), initial=0.0))
    alpha = 4.0 * rho**2 / ((1.0 - rho) ** 2 * (1.0 + rho) ** 2)
    width = np.ceil(1.1447 * (alpha * samples) ** (1.0 / 3.0))
    return max(1, int(np.clip(width, np.ceil(samples / MOST_BLOCKS), max(1, samples // FEWEST_BLOCKS))))


def block_count(samples: int, length: int) -> int:
    """Number of blocks of `length` samples, the last one possibly shorter."""
    return -(-samples // length)


@dataclass(frozen=True, eq=False)
class BlockRows:
    """Consecutive samples of one block."""

    index: int  # of the block
    samples: npt.NDArray[np.int64]  # (m,) which of the segment's filtered samples
    regressor: FloatArray  # (kernel.row_count, m) packed rows
    torque: FloatArray  # (k, m) filtered


def rows_by_block(
    kernel: RegressorKernel,
    segment: Segment,
    parallel_filter: ZeroPhaseFilter,
    blocks: npt.NDArray[np.int64],
    torque: FloatArray | None = None,
) -> Iterator[BlockRows]:
    """Stream a segment's equations, cut where the block changes.

    Args:
        kernel: gives the regressor's packed rows.
        segment: motion on a uniform grid.
        parallel_filter: for τ and W.
        blocks: (M,) index of each filtered sample's block.
        torque: (k, N) to be filtered in the same way; none where None.
    """
    torque = np.empty((0, len(segment.time))) if torque is None else torque
    position = 0
    for filtered in filtered_samples(kernel, segment, parallel_filter, torque):
        samples = position + np.flatnonzero(filtered.used)
        position += len(filtered.used)
        if len(samples) == 0:
            continue
        regressor, filtered_torque = filtered.regressor[:, filtered.used], filtered.torque[:, filtered.used]
        block_of_sample = blocks[samples]
        edges = [0, *(np.flatnonzero(np.diff(block_of_sample)) + 1).tolist(), len(block_of_sample)]
        for start, stop in pairwise(edges):
            within = slice(start, stop)
            yield BlockRows(
                int(block_of_sample[start]), samples[within], regressor[:, within], filtered_torque[:, within]
            )


def add_torque_rows(
    sums: BlockSums,
    kernel: RegressorKernel,
    solution: LeastSquares,
    block_rows: Iterator[BlockRows],
    residual: FloatArray,
) -> None:
    """Add one segment's equations of the active columns; `residual` (n, M) of its filtered samples."""
    place = {column: position for position, column in enumerate(solution.active)}
    # Which packed rows belong to active columns, and to which of them.
    chosen = []
    for joint in kernel.joint_rows:
        pairs = [(joint.rows.start + i, place[column]) for i, column in enumerate(joint.columns) if column in place]
        chosen.append(([row for row, _ in pairs], np.array([column for _, column in pairs], dtype=int)))
    for block in block_rows:
        gram, score = sums.gram[block.index], sums.score[block.index]
        for motor, (packed_rows, columns) in enumerate(chosen):
            rows = solution.weights[motor] * block.regressor[packed_rows]
            gram[columns[:, None], columns] += rows @ rows.T
            score[columns] += rows @ (solution.weights[motor] * residual[motor, block.samples])
