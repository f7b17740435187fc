"""Least squares on equations of the whole arm's energy: one scalar equation a row instead of one a joint.

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

from drivers.streams import FloatArray
from ident.linear_algebra.triangular import QrAccumulator
from ident.model.energy import EnergyKernel
from ident.regression.autocorrelation import independent_share, lag_one, residual_autocorrelation
from ident.regression.jackknife import BlockSum, CorrectedCovariance, FilteredRun, block_length, jackknife, total_gram
from ident.regression.least_squares import LeastSquares
from ident.regression.observation_matrix import JointFactor, Reduction
from ident.signals.filters import ZeroPhaseFilter
from ident.signals.prepared import Prepared, Segment
from ident.signals.repetition import motion_phases


@dataclass(frozen=True)
class EnergyRows:
    """Some of the equations, in the order of time.

    Attributes:
        regressor: (b, M) of base columns [J or W a unit].
        work: (M,) what the motors did [J or W].
        sample: (M,) number of the parallel filter's output sample that each belongs to.
    """

    regressor: FloatArray
    work: FloatArray
    sample: npt.NDArray[np.int64]


class EnergyEquations(Protocol):
    """A way to make equations out of a segment."""

    @property
    def kernel(self) -> EnergyKernel:
        """For the base columns."""

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


def independent_rows(equations: EnergyEquations, parts: Sequence[Prepared], parameters: FloatArray) -> float:
    """Number of independent equations that the residuals of base parameters (b,) are worth."""
    residuals = [
        (rows.work - parameters @ rows.regressor)[None]
        for part in parts
        for segment in part.segments
        for rows in equations.rows(segment, part.parallel_filter)
    ]
    count: int = sum(residual.shape[1] for residual in residuals)
    return count * independent_share(lag_one(residuals))


def energy_jackknife(
    equations: EnergyEquations, runs: Sequence[FilteredRun], solution: LeastSquares
) -> CorrectedCovariance:
    """Corrected covariance of a solution's active parameters: delete-block jackknife as for the torque equations.

    Rows that overlap have residuals that depend on each other; a block is several times longer than they do.
    """
    series = [part for run in runs for part in run.series]
    phases = motion_phases([part.velocity for part in series])
    counted = np.concatenate([phase[part.used] for phase, part in zip(phases, series, strict=True)])
    different = np.unique(counted)
    active = list(solution.active)
    parts: list[tuple[FloatArray, FloatArray, npt.NDArray[np.int64]]] = []
    remaining = iter(phases)
    for run in runs:
        for segment in run.segments:
            phase = next(remaining)
            for rows in equations.rows(segment, run.parallel_filter):
                residual = rows.work - solution.parameters @ rows.regressor
                parts.append((rows.regressor[active], residual, np.searchsorted(different, phase[rows.sample])))
    of_rows = lag_one([residual[None] for _, residual, _ in parts])
    samples_a_row = len(counted) / solution.rows
    new = len(different) / len(counted)
    length_in_rows = max(equations.overlap, block_length(of_rows, round(new * solution.rows)))
    length = int(np.ceil(samples_a_row * length_in_rows))
    sums: dict[int, BlockSum] = {}
    for regressor, residual, place in parts:
        number = place // length
        for block_number in np.unique(number).tolist():
            inside = number == block_number
            block = sums.setdefault(block_number, BlockSum(np.zeros((len(active),) * 2), np.zeros(len(active))))
            block.gram += regressor[:, inside] @ regressor[:, inside].T
            block.score += regressor[:, inside] @ residual[inside]
    effective = solution.rows * independent_share(of_rows) * new
    return CorrectedCovariance(
        jackknife(sums, total_gram(sums)), length, len(sums), residual_autocorrelation(series), effective, 1.0 / new
    )
