"""The energy model: differences of energy over windows of time (SR400 eq. 10 to 12).

    H(t_b) − H(t_a) + Σ (Fv·∫q̇² dt + Fs·∫|q̇| dt + Fo·∫q̇ dt) = ∫ q̇mᵀτ dt

A window is informative only if energy is exchanged in it: one in which the arm barely moves is a row of noise. So
windows are not cut by the clock but by the exchange ∫ Σ|q̇m·τ| dt, of which each holds the same amount; they are short
where the arm is fast and long near velocity reversals. Each begins a quarter of its exchange after the one before, so
that what happens near its ends is seen in the middle of others.

Both sides, as functions of a window's end, pass the parallel filter before they are differenced (SR400 .4.3 point 4): H
holds q̇ squared at the two ends alone, where nothing else would average the encoders' noise. Longer windows hold more
signal beside this noise; but there must be many more of them than parameters, and much longer than the motion's own
periods they average it away.

The estimate is least squares with one scalar equation per row instead of one per joint. `EnergyWindows` (differences of
energy, SR400 eq. 10 to 12) and `power` (their differential form) make the rows; here they become a `Reduction` and
error bars, as the joints' torque equations do in `observation_matrix` and `ident.regression.jackknife`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import FloatArray, true_runs
from drivers.core.errors import DataError
from ident.assessment.plausibility import critical_variance_ratio, refitted
from ident.estimators.estimator import Estimation, Estimator, Setup
from ident.linear_algebra.triangular import QrAccumulator
from ident.model.base_parameters import BaseParameters
from ident.model.dynamic_model import DynamicModel
from ident.model.dynamics.energy import STATES_AT_ONCE, EnergyKernel, energy_base_parameters, motor_velocity
from ident.regression.comparison import independent_share, lag_one, residual_autocorrelation
from ident.regression.jackknife import (
    CorrectedCovariance,
    FilteredRun,
    MotionBlocks,
    block_length,
    distinct_samples,
    tolerant_moves,
)
from ident.regression.least_squares import LeastSquares, ordinary_least_squares
from ident.regression.observation_matrix import JointFactor, Reduction, stack_reductions
from ident.signals.filters import StreamedFilter, ZeroPhaseFilter
from ident.signals.prepared import Prepared, Segment, Step

HALF_POWER = 0.443
"""Frequency times duration at which a moving average passes half the power."""

SHORTEST_CUTOFF, LONGEST_CUTOFF = 1.0, 0.1
"""Windows of mean duration pass, as moving averages, half the power at one of these shares of the parallel filter's
cut-off, or in between: at the cut-off itself, or at a tenth of it, where the motion's band ends."""

WINDOWS_PER_PARAMETER = 4.0
"""Windows are made no longer than leaves this many, side by side, for each base parameter."""

OVERLAP = 4
"""How many windows each instant belongs to."""


@dataclass(frozen=True)
class EnergyRows:
    """Some of the equations, in the order of time."""

    regressor: FloatArray  # (b, M) of base columns [J or W per unit]
    work: FloatArray  # (M,) what the motors did [J or W]
    sample: npt.NDArray[np.int64]  # (M,) index of the parallel filter's output sample that each belongs to


class EnergyEquations(Protocol):
    """Equations of a segment, by one method."""

    @property
    def kernel(self) -> EnergyKernel:
        """The kernel of the base columns."""

    @property
    def overlap(self) -> int:
        """Return how many consecutive rows share data; 1 where they do not."""

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


@dataclass(frozen=True)
class EnergyWindows:
    """Equations over windows of equal exchange."""

    kernel: EnergyKernel  # for the base columns
    exchange: float  # ∫ Σ|q̇m·τ| dt of each window, to a sample [J]

    @property
    def overlap(self) -> int:
        """Return how many consecutive rows share data."""
        return OVERLAP

    def rows(self, segment: Segment, parallel_filter: ZeroPhaseFilter) -> Iterator[EnergyRows]:
        """The equations of one segment; energy and work are filtered at the segment's rate."""
        model = self.kernel.model
        borders = [window_borders(model, segment, span, self.exchange) for span in moving_spans(segment)]
        borders = [samples for samples in borders if len(samples) > OVERLAP]
        if not borders:
            return
        balance = self._balance_at(np.concatenate(borders), segment, replace(parallel_filter, factor=1))
        position = 0
        for samples in borders:
            at_borders = balance[:, position : position + len(samples)]
            position += len(samples)
            rows = at_borders[:, OVERLAP:] - at_borders[:, :-OVERLAP]
            middle = (samples[:-OVERLAP] + samples[OVERLAP:]) // 2
            yield EnergyRows(rows[:-1], rows[-1], middle // parallel_filter.factor)

    def _balance_at(self, samples: npt.NDArray[np.int64], segment: Segment, smoothing: ZeroPhaseFilter) -> FloatArray:
        """Energy stored and lost since the start, last the work, filtered, at rising samples (k,) → (b + 1, k)."""
        streamed = StreamedFilter(smoothing, len(self.kernel.columns) + 1)
        balance = np.empty((len(self.kernel.columns) + 1, len(samples)))
        position = 0
        for chunk in self._balance(segment):
            filtered = streamed.finish() if chunk is None else streamed.push(chunk)
            start, stop = np.searchsorted(samples, [position, position + filtered.shape[1]])
            balance[:, start:stop] = filtered[:, samples[start:stop] - position]
            position += filtered.shape[1]
        return balance

    def _balance(self, segment: Segment) -> Iterator[FloatArray | None]:
        """Energy stored and lost since the start (b, m), and last the work, chunk by chunk; None behind the end."""
        from scipy.integrate import cumulative_trapezoid

        count = segment.position.shape[1]
        work = motor_power(self.kernel.model, segment)
        spent = np.zeros((len(self.kernel.friction_rows) + 1, 1))
        for start in range(0, count, STATES_AT_ONCE):
            inside = slice(start, min(start + STATES_AT_ONCE, count))
            # With the last sample of the chunk before, so that the integral goes on from there.
            around = slice(max(0, start - 1), inside.stop)
            power = np.vstack([self.kernel.friction_power(*friction_motion(segment, around)), work[around]])
            integral = spent + cumulative_trapezoid(power, dx=1.0 / segment.rate, axis=1, initial=0)
            spent = integral[:, -1:]
            integral = integral[:, inside.start - around.start :]
            balance = np.vstack(
                [self.kernel.energy(segment.position[:, inside], segment.velocity[:, inside]), integral[-1:]]
            )
            balance[self.kernel.friction_rows] = integral[:-1]
            yield balance
        yield None


def friction_motion(segment: Segment, samples: slice) -> tuple[FloatArray, FloatArray, FloatArray | None]:
    """Velocity, position and, where recorded, temperature of some samples, which the friction's power follows from."""
    heat = None if segment.temperature is None else segment.temperature[:, samples]
    return segment.velocity[:, samples], segment.position[:, samples], heat


def motor_power(model: DynamicModel, segment: Segment) -> FloatArray:
    """q̇mᵀτ (N,) [W]."""
    return np.asarray(np.einsum("nk,nk->k", motor_velocity(model, segment.velocity), segment.torque))


def moving_spans(segment: Segment) -> tuple[slice, ...]:
    """Spans of consecutive samples that count."""
    return tuple(slice(start, stop) for start, stop in true_runs(segment.used))


def exchange_rate(model: DynamicModel, segment: Segment) -> FloatArray:
    """Σ|q̇m·τ| (N,) [W]."""
    return np.asarray(np.abs(motor_velocity(model, segment.velocity) * segment.torque).sum(axis=0))


def exchange_for(model: DynamicModel, segments: Sequence[Segment], duration: float) -> float:
    """Exchange [J] of windows that last `duration` [s] on average over all segments.

    Raises:
        DataError: no energy is exchanged at all.
    """
    total = sum(float(exchange_rate(model, segment)[segment.used].sum()) for segment in segments)
    samples = sum(int(segment.used.sum()) for segment in segments)
    if not total > 0.0:
        raise DataError("no energy is exchanged: the torque is zero whenever the arm moves", hint="use --method wls")
    return duration * total / samples


def mean_duration(kernel: EnergyKernel, segments: Sequence[Segment], cutoff: float) -> float:
    """Mean duration [s] of windows for a parallel filter of this cut-off [Hz]: as long as the data allow."""
    moving = sum(int(segment.used.sum()) / segment.rate for segment in segments)
    enough = moving / (WINDOWS_PER_PARAMETER * len(kernel.columns))
    return float(np.clip(enough, HALF_POWER / (SHORTEST_CUTOFF * cutoff), HALF_POWER / (LONGEST_CUTOFF * cutoff)))


def window_borders(model: DynamicModel, segment: Segment, span: slice, exchange: float) -> npt.NDArray[np.int64]:
    """Samples of the segment, `exchange` / `OVERLAP` apart; a window ends at the `OVERLAP`-th behind its start."""
    from scipy.integrate import cumulative_trapezoid

    spent = cumulative_trapezoid(exchange_rate(model, segment)[span], dx=1.0 / segment.rate, initial=0)
    levels = np.arange(0.0, spent[-1], exchange / OVERLAP)
    return np.asarray(np.unique(np.searchsorted(spent, levels)) + span.start)


def describe_windows(equations: EnergyWindows, segments: Sequence[Segment]) -> tuple[int, float]:
    """Number of windows and their mean duration [s]."""
    lengths = [
        (borders[OVERLAP:] - borders[:-OVERLAP]) / segment.rate
        for segment in segments
        for span in moving_spans(segment)
        if len(borders := window_borders(equations.kernel.model, segment, span, equations.exchange)) > OVERLAP
    ]
    durations = np.concatenate([*lengths, np.empty(0)])
    return len(durations), float(durations.mean()) if len(durations) else 0.0


@dataclass(frozen=True)
class EnergyEstimator:
    """Least squares on the arm's energy."""

    setup: Setup  # the data
    equations: EnergyEquations  # of the energy
    name: str  # of the method

    def notes(self, run: Prepared) -> tuple[Step, ...]:
        """The energy windows, where there are any."""
        if not isinstance(self.equations, EnergyWindows):
            return ()
        count, duration = describe_windows(self.equations, run.segments)
        exchange = self.equations.exchange
        text = (
            f"{count} windows, each exchanging {exchange:.3g} J between motors and arm, {duration:.3g} s long on "
            f"average; each instant belongs to {self.equations.overlap}"
        )
        return (Step("energy windows", {"windows": count, "exchange_j": exchange, "mean_s": duration}, text),)

    def reduce(self, runs: Sequence[Prepared]) -> Reduction:
        """One factor for the whole arm."""
        return stack_reductions([reduce_energy(self.equations, run.segments, run.parallel_filter) for run in runs])

    def estimate(self, runs: Sequence[Prepared], plain: Reduction, active: Sequence[int]) -> Estimation:
        """OLS: windows of equal exchange have equal weight."""
        return Estimation(self.setup.kernel, plain, self._solve(plain, active))

    def covariance(self, runs: Sequence[FilteredRun], estimation: Estimation) -> CorrectedCovariance:
        """Delete-block jackknife over time."""
        return energy_jackknife(self.equations, runs, estimation.solution)

    def restricted(self, estimation: Estimation, columns: Sequence[int]) -> LeastSquares:
        """OLS of fewer columns."""
        return self._solve(estimation.reduction, columns)

    def _solve(self, reduction: Reduction, active: Sequence[int]) -> LeastSquares:
        return replace(ordinary_least_squares(reduction, active), method=self.name)


def estimable(model: DynamicModel, base: BaseParameters) -> tuple[int, ...]:
    """Indices of the base parameters that the energy's equations can identify, whatever the data."""
    kept = set(energy_base_parameters(model).columns)
    return tuple(index for index, column in enumerate(base.columns) if column in kept)


def fits_energy_better(
    other: Estimator, runs: Sequence[Prepared], active: Sequence[int], residual_sum: float, independent: float
) -> bool:
    """Return whether another energy model's residual is significantly smaller than `residual_sum`.

    Args:
        other: of the other model's equations; the torque equations' never fit better in this sense.
        runs: the data.
        active: base columns to fit.
        residual_sum: of the model in question.
        independent: equations that its residuals are worth; the better model's are whiter, and count if they are more.
    """
    if not isinstance(other, EnergyEstimator):
        return False
    solution = refitted(other.reduce(runs), active)
    rows = max(independent, independent_rows(other.equations, runs, solution.parameters))
    return solution.residual_sum < critical_variance_ratio(rows - len(active)) * residual_sum
