"""Moment equations Zᵀ(τ − W·θ) = 0, streamed, and the jackknife of their solution.

Least squares has Z = W. Instruments Z that are independent of the errors of W and τ take their bias away; rows may also
be whitened before. Leaving out block b moves the solution of (ZᵀW + P)·θ = Zᵀτ by

    δ_b = (ZᵀW + P − Z_bᵀW_b)⁻¹ Z_bᵀ(τ_b − W_b·θ)

with P a penalty or a correction that is kept (`ident.regression.jackknife` has the rest).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import FloatArray
from drivers.core.errors import IdentificationError
from ident.model.regressor import RegressorKernel
from ident.regression.comparison import TorqueSeries, independent_share
from ident.regression.jackknife import BlockSums, CorrectedCovariance, MotionBlocks, motion_blocks, tolerant_moves
from ident.regression.least_squares import LeastSquares
from ident.regression.observation_matrix import FilteredSamples, filtered_samples
from ident.signals.filters import ZeroPhaseFilter
from ident.signals.prepared import Segment


@dataclass(frozen=True, eq=False)
class MomentRows:
    """Consecutive equations of one motor."""

    motor: int  # index
    samples: npt.NDArray[np.int64]  # (m,) which of the segment's filtered samples they are
    columns: tuple[int, ...]  # (k,) base columns that are not structurally zero in them
    instruments: FloatArray  # (k, m)
    regressor: FloatArray  # (k, m)
    torque: FloatArray  # (m,) [N·m]


@dataclass(frozen=True, eq=False)
class SegmentRows:
    """A segment's equations, with instruments from another motion."""

    kernel: RegressorKernel  # of the base columns
    segment: Segment  # motion and torque
    parallel_filter: ZeroPhaseFilter  # for τ, W and Z
    # the same samples of a motion whose regressor is Z; the segment itself where None
    instruments: Segment | None = None

    def __iter__(self) -> Iterator[MomentRows]:
        """Stream them; arrays are valid until the next one is requested."""
        kernel, segment = self.kernel, self.segment
        if self.instruments is None:
            measured = filtered_samples(kernel, segment, self.parallel_filter, segment.torque)
            pairs: Iterable[tuple[FilteredSamples, FilteredSamples]] = ((rows, rows) for rows in measured)
        else:
            segment = replace(segment, used=segment.used & self.instruments.used)
            other = replace(self.instruments, used=segment.used, reversing=segment.reversing)
            nothing = np.empty((0, len(segment.time)))
            pairs = zip(
                filtered_samples(kernel, segment, self.parallel_filter, segment.torque),
                filtered_samples(kernel, other, self.parallel_filter, nothing),
                strict=True,
            )
        position = 0
        for filtered, instrument in pairs:
            for motor, rows in enumerate(kernel.joint_rows):
                counts = filtered.counts(motor)
                yield MomentRows(
                    motor,
                    position + np.flatnonzero(counts),
                    rows.columns,
                    instrument.regressor[rows.rows][:, counts],
                    filtered.regressor[rows.rows][:, counts],
                    filtered.torque[motor, counts],
                )
            position += len(filtered.used)


def moment_jackknife(
    series: Sequence[TorqueSeries],
    sources: Sequence[Iterable[MomentRows]],
    solution: LeastSquares,
    penalty: FloatArray | None = None,
) -> CorrectedCovariance:
    """Delete-block covariance of a solution of moment equations.

    Args:
        series: measured and predicted torques of every segment.
        sources: the equations of every segment, in the same order.
        solution: of them, with the weights (n,) of the joints' rows.
        penalty: P (a, a) of the active columns; 0 where None.

    Raises:
        IdentificationError: the instruments do not follow the regressor.
    """
    blocks = motion_blocks(series)
    share = independent_share(blocks.autocorrelation[solution.weights > 0])
    return blocks.corrected(moment_moves(blocks, sources, solution, penalty), solution.rows, share)


def moment_moves(
    blocks: MotionBlocks,
    sources: Sequence[Iterable[MomentRows]],
    solution: LeastSquares,
    penalty: FloatArray | None = None,
) -> FloatArray:
    """(B, a) how far leaving out each block moves a solution of moment equations.

    Args:
        blocks: of every segment.
        sources: the equations of every segment, in the same order.
        solution: of them, with the weights (n,) of the joints' rows.
        penalty: P (a, a) of the active columns; 0 where None.

    Raises:
        IdentificationError: the instruments do not follow the regressor.
    """
    sums = blocks.sums(len(solution.active))
    place = np.full(len(solution.parameters), -1)
    place[list(solution.active)] = np.arange(len(solution.active))
    used = solution.weights > 0
    for of_sample, source in zip(blocks.of_segments, sources, strict=True):
        for rows in source:
            if used[rows.motor]:
                _add(sums, place, solution, rows, of_sample[rows.samples])
    normal = sums.gram.sum(axis=0)
    if penalty is not None:
        normal = normal + penalty
    if not np.all(np.diag(normal) > 0.0):
        raise IdentificationError("the instruments do not follow the recorded motion", hint="use --method wls")
    return tolerant_moves(BlockSums(sums.gram, sums.score - sums.score.mean(axis=0)), normal)


def _add(
    sums: BlockSums,
    place: npt.NDArray[np.int64],
    solution: LeastSquares,
    rows: MomentRows,
    blocks: npt.NDArray[np.int64],
) -> None:
    """Add one motor's equations, those of each block to its sums."""
    inside = np.flatnonzero(place[list(rows.columns)] >= 0)
    columns = place[list(rows.columns)][inside]
    weight = solution.weights[rows.motor]
    instruments, regressor = weight * rows.instruments[inside], weight * rows.regressor[inside]
    residual = weight * rows.torque - solution.parameters[list(solution.active)][columns] @ regressor
    edges = np.concatenate([[0], np.flatnonzero(np.diff(blocks)) + 1, [len(blocks)]])
    for start, stop in pairwise(edges.tolist()):
        if stop > start:
            block, part = blocks[start], slice(start, stop)
            sums.gram[block][columns[:, None], columns] += instruments[:, part] @ regressor[:, part].T
            sums.score[block][columns] += instruments[:, part] @ residual[part]
