"""Least squares on equations of the whole arm's energy: one scalar equation per row instead of one per joint.

`energy_windows` (differences of energy, SR400 eq. 10 to 12) and `power` (their differential form) make the
rows; here they become a `Reduction` and error bars, as the joints' torque equations do in `observation_matrix` and
`ident.regression.jackknife`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import FloatArray
from ident.linear_algebra.triangular import QrAccumulator
from ident.model.dynamics.energy import EnergyKernel
from ident.regression.comparison import independent_share, lag_one, residual_autocorrelation
from ident.regression.jackknife import (
    CorrectedCovariance,
    FilteredRun,
    MotionBlocks,
    block_length,
    distinct_samples,
    tolerant_moves,
)
from ident.regression.least_squares import LeastSquares
from ident.regression.observation_matrix import JointFactor, Reduction
from ident.signals.filters import ZeroPhaseFilter
from ident.signals.prepared import Prepared, Segment


@dataclass(frozen=True)
class EnergyRows:
    """Some of the equations, in the order of time.

    Attributes:
        regressor: (b, M) of base columns [J or W per unit].
        work: (M,) what the motors did [J or W].
        sample: (M,) index of the parallel filter's output sample that each belongs to.
    """

    regressor: FloatArray
    work: FloatArray
    sample: npt.NDArray[np.int64]


class EnergyEquations(Protocol):
    """Equations of a segment, by one method."""

    @property
    def kernel(self) -> EnergyKernel:
        """The kernel of the base columns."""

    @property
    def overlap(self) -> int:
        """How many consecutive rows share data; 1 where they do not."""

    def rows(self, segment: Segment, parallel_filter: ZeroPhaseFilter) -> Iterator[EnergyRows]:
        """The equations of one segment."""


def reduce_energy(
    equations: EnergyEquations, segments: Sequence[Segment], parallel_filter: ZeroPhaseFilter
) -> Reduction:
    """Reduce a recording's energy equations to one triangular factor."""
    count = len(equations.kernel.columns)
    accumulator = QrAccumulator(count + 1)
    for segment in segments:
        for rows in equations.rows(segment, parallel_filter):
            accumulator.add(np.vstack([rows.regressor, rows.work]))
    return Reduction(
        joints=(JointFactor(tuple(range(count)), accumulator.factor(), accumulator.rows),),
        column_count=count,
        torque_count=1,
        samples=accumulator.rows,
        method="QR of stacked blocks",
    )


def independent_rows(equations: EnergyEquations, runs: Sequence[Prepared], parameters: FloatArray) -> float:
    """Number of independent equations that the residuals of base parameters (b,) are worth."""
    residuals = [
        (rows.work - parameters @ rows.regressor)[None]
        for run in runs
        for segment in run.segments
        for rows in equations.rows(segment, run.parallel_filter)
    ]
    count: int = sum(residual.shape[1] for residual in residuals)
    return count * independent_share(lag_one(residuals))


def energy_jackknife(
    equations: EnergyEquations, runs: Sequence[FilteredRun], solution: LeastSquares
) -> CorrectedCovariance:
    """Corrected covariance of a solution's active parameters: delete-block jackknife as for the torque equations.

    Rows that overlap have residuals that depend on each other; a block is several times longer than they do.
    """
    series = [torques for run in runs for torques in run.series]
    samples = distinct_samples(series)
    active = list(solution.active)
    indices = iter(samples.indices)
    equation_parts: list[tuple[FloatArray, FloatArray, npt.NDArray[np.int64]]] = []
    for run in runs:
        for segment in run.segments:
            sample_numbers = next(indices)
            for rows in equations.rows(segment, run.parallel_filter):
                residual = rows.work - solution.parameters @ rows.regressor
                equation_parts.append((rows.regressor[active], residual, sample_numbers[rows.sample]))
    of_rows = lag_one([residual[None] for _, residual, _ in equation_parts])
    samples_per_row = sum(int(torques.used.sum()) for torques in series) / solution.rows
    length_in_rows = max(equations.overlap, block_length(of_rows, round(samples.share * solution.rows)))
    length = int(np.ceil(samples_per_row * length_in_rows))
    blocks = MotionBlocks(samples, length, residual_autocorrelation(series))
    sums = blocks.sums(len(active))
    for regressor, residual, sample_numbers in equation_parts:
        sums.add(sample_numbers // length, regressor, residual)
    sums = sums.occupied  # windows hold many samples: a block may be left without a row
    moves = tolerant_moves(sums, sums.gram.sum(axis=0))
    return blocks.corrected(moves, solution.rows, independent_share(of_rows))
