"""Maximum likelihood with autoregressive noise of the torques.

The best prediction of e(t) from the k samples before it is −(a₁·e(t−1) + … + a_k·e(t−k)), its error has the variance
v_k (Levinson and Durbin; Box and Jenkins, ch. 3 and 7). An equation minus what the p before it predict has independent
errors; behind a gap, where only k < p samples are known, order k is used, weighted by √(v_p/v_k). Their least squares
is the maximum of the likelihood: Gauss and Markov's estimate for noise of order p, no equation lost.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import numpy.typing as npt
from pydantic import Field

from drivers.core.arrays import BoolArray, FloatArray
from drivers.core.ranges import Range
from ident.estimators.estimator import Estimation, EstimationLoop, Estimator, Setup
from ident.estimators.method import Method, within
from ident.estimators.torque_estimator import TorqueEstimator
from ident.linear_algebra.triangular import QrAccumulator
from ident.model.regressor import RegressorKernel
from ident.regression.comparison import TorqueSeries, compare_torques
from ident.regression.jackknife import CorrectedCovariance, FilteredRun
from ident.regression.least_squares import LeastSquares, residual_deviations, weighted_least_squares
from ident.regression.moment_equations import MomentRows, moment_jackknife
from ident.regression.observation_matrix import JointFactor, Reduction, filtered_samples
from ident.signals.filters import ZeroPhaseFilter
from ident.signals.prepared import Prepared, Segment

LEAST_INNOVATION = 1e-6
"""Share of the residual's variance; an order that leaves less is rounding."""


def whitening_filters(
    residuals: Sequence[FloatArray], counted: Sequence[BoolArray], most: int, order: int | None = None
) -> FloatArray:
    """Filters (p + 1, p + 1) of the noise in series of residuals: row k for a sample with k known ones before it.

    Args:
        residuals: each (M,).
        counted: of the same, (M,) whether a sample counts.
        most: largest order that is tried.
        order: p; the one with the least BIC (Schwarz 1978) where None. Less where the data bear out no more.
    """
    known = [np.where(counts, residual, 0.0) for residual, counts in zip(residuals, counted, strict=True)]
    covariances = np.zeros(most + 1)
    for lag in range(most + 1):
        products = sum(float(e[lag:] @ e[: len(e) - lag]) for e in known if len(e) > lag)
        pairs = sum(int(np.sum(c[lag:] & c[: len(c) - lag])) for c in counted if len(c) > lag)
        covariances[lag] = products / max(pairs, 1)
    if covariances[0] <= 0.0:
        return np.ones((1, 1))
    predictors, variances = [np.ones(1)], [covariances[0]]
    for k in range(1, most + 1):
        before = predictors[-1]
        reflection = -float(before @ covariances[k:0:-1]) / variances[-1]
        variance = variances[-1] * (1.0 - reflection**2)
        if variance <= LEAST_INNOVATION * covariances[0]:
            break
        predictors.append(np.append(before, 0.0) + reflection * np.append(0.0, before[::-1]))
        variances.append(variance)
    if order is None:
        count = sum(int(counts.sum()) for counts in counted)
        order = int(np.argmin(count * np.log(variances) + np.arange(len(variances)) * np.log(max(count, 1))))
    order = min(order, len(variances) - 1)
    filters = np.zeros((order + 1, order + 1))
    for k in range(order + 1):
        filters[k, : k + 1] = np.sqrt(variances[order] / variances[k]) * predictors[k]
    return filters


@dataclass(frozen=True, eq=False)
class WhitenedRows:
    """A segment's equations, whitened.

    Attributes:
        kernel: of the base columns.
        segment: motion and torque.
        parallel_filter: for τ and W.
        filters: of each joint, as `whitening_filters` gives them.
    """

    kernel: RegressorKernel
    segment: Segment
    parallel_filter: ZeroPhaseFilter
    filters: tuple[FloatArray, ...]

    def __iter__(self) -> Iterator[MomentRows]:
        """Stream them; arrays are valid until the next one is requested."""
        kernel, segment = self.kernel, self.segment
        before = [
            (np.zeros((len(rows.columns) + 1, len(table) - 1)), 0)
            for rows, table in zip(kernel.joint_rows, self.filters, strict=True)
        ]
        position = 0
        for filtered in filtered_samples(kernel, segment, self.parallel_filter, segment.torque):
            width = len(filtered.used)
            for motor, (rows, table) in enumerate(zip(kernel.joint_rows, self.filters, strict=True)):
                order = len(table) - 1
                past, known = before[motor]
                present = np.concatenate([filtered.regressor[rows.rows], filtered.torque[motor : motor + 1]])
                together = np.concatenate([past, present], axis=1)
                counts = filtered.counts(motor)
                known_before = _known_before(counts, known)
                taps = table[np.minimum(known_before, order)]
                white = np.zeros_like(present)
                for lag in range(order + 1):
                    white += taps[:, lag] * together[:, order - lag : order - lag + width]
                regressor = white[:-1, counts]
                samples = position + np.flatnonzero(counts)
                yield MomentRows(motor, samples, rows.columns, regressor, regressor, white[-1, counts])
                ended = int(known_before[-1]) + 1 if counts[-1] else 0
                before[motor] = together[:, together.shape[1] - order :], ended
            position += width


def _known_before(counts: BoolArray, carried: int) -> npt.NDArray[np.int64]:
    """How many samples (m,) in a row right before each one count, `carried` of them before the first."""
    place = np.arange(len(counts))
    last_gap = np.maximum.accumulate(np.where(counts, -1, place))  # up to this sample
    last_gap = np.concatenate([[-1], last_gap[:-1]])
    return np.where(last_gap < 0, place + carried, place - last_gap - 1)


MOST_ORDERS = 4
"""Largest order that the choice by BIC tries."""

SAMPLES_PER_PERIOD = 2.0
"""Filtered samples per period of the parallel filter's cut-off."""

ITERATIONS = 30
WHITENING_SETTLED = 1e-3
"""Largest change of a parameter, over its classical deviation."""


@dataclass(frozen=True)
class MlOptions:
    """Options of maximum likelihood."""

    order: Annotated[
        int | None,
        within(Range(0, 50)),
        Field(description=f"of the noise model, every joint alike; by BIC per joint, up to {MOST_ORDERS}, if absent"),
    ] = None


@dataclass(frozen=True, eq=False, kw_only=True)
class MlEstimation(Estimation):
    """An estimate with its noise model.

    Attributes:
        filters: of each joint, that whiten its noise.
    """

    filters: tuple[FloatArray, ...]


def at_filter_rate(run: Prepared) -> Prepared:
    """The run with its filtered samples thinned out to `SAMPLES_PER_PERIOD`.

    At a higher rate their spectrum ends below half the rate. Whitening would amplify what little is left there, where
    the model's errors and the positions' noise are, until it outweighs the rest: it would undo the filter.
    """
    stride = max(1, int(run.filtered_rate / (SAMPLES_PER_PERIOD * run.cutoffs.torque)))
    thinned = replace(run.parallel_filter, factor=run.parallel_filter.factor * stride)
    return replace(run, parallel_filter=thinned)


@dataclass(frozen=True)
class MlEstimator(TorqueEstimator):
    """Weighted least squares of equations whitened by the residual's autoregression, iterated.

    Attributes:
        order: of the noise model; by BIC where None.
    """

    order: int | None

    def reduce(self, runs: Sequence[Prepared]) -> Reduction:
        """One factor per joint, of the samples that the filter leaves independent."""
        return super().reduce([at_filter_rate(run) for run in runs])

    def estimate(self, runs: Sequence[Prepared], plain: Reduction, active: Sequence[int]) -> Estimation:
        """Parameters and noise model in turn, each the maximum of the likelihood given the other."""
        kernel = self.setup.kernel
        runs = [at_filter_rate(run) for run in runs]
        solution = self.solve(plain, active)
        changes: list[float] = []
        while len(changes) < ITERATIONS and (not changes or changes[-1] > WHITENING_SETTLED):
            filters = self._filters(runs, solution)
            reduction = self._whitened(runs, plain, filters)
            refined = self.solve(reduction, active)
            moved = np.abs(refined.parameters - solution.parameters)[list(active)]
            changes.append(float(np.max(moved / refined.std[list(active)])))
            solution = refined
        loop = EstimationLoop("parameters and noise model", "σ", tuple(changes), changes[-1] <= WHITENING_SETTLED)
        return MlEstimation(
            kernel,
            reduction,
            self._named(solution, plain),
            (loop,),
            passes=1 + 2 * len(changes),
            filters=filters,
        )

    def covariance(self, runs: Sequence[FilteredRun], estimation: Estimation) -> CorrectedCovariance:
        """Delete-block jackknife of the whitened equations."""
        assert isinstance(estimation, MlEstimation)
        kernel, parameters = estimation.kernel, estimation.solution.parameters
        series: list[TorqueSeries] = []
        sources: list[WhitenedRows] = []
        for run, prepared in zip(runs, self.setup.runs, strict=True):
            thinned = at_filter_rate(prepared).parallel_filter
            series += compare_torques(kernel.model, kernel.columns, parameters, run.segments, thinned)
            sources += [WhitenedRows(kernel, segment, thinned, estimation.filters) for segment in run.segments]
        return moment_jackknife(series, sources, estimation.solution)

    def restricted(self, estimation: Estimation, columns: Sequence[int]) -> LeastSquares:
        """The whitened equations of fewer columns."""
        return replace(self.solve(estimation.reduction, columns), method="ml")

    def _named(self, solution: LeastSquares, plain: Reduction) -> LeastSquares:
        """The solution with the deviations of the torques' residuals, in place of those of the innovations."""
        deviations = residual_deviations(plain, solution.parameters, len(solution.active))
        return replace(solution, method="ml", joint_std=deviations)

    def _filters(self, runs: Sequence[Prepared], solution: LeastSquares) -> tuple[FloatArray, ...]:
        kernel = self.setup.kernel
        residuals, counted = [], []
        for run in runs:
            series = compare_torques(
                kernel.model, kernel.columns, solution.parameters, run.segments, run.parallel_filter
            )
            for torques, segment in zip(series, run.segments, strict=True):
                every = slice(None, None, run.parallel_filter.factor)
                left_out = False if segment.reversing is None else segment.reversing[:, every]
                residuals.append(torques.residual)
                counted.append(torques.used & ~np.broadcast_to(left_out, torques.residual.shape))
        most = MOST_ORDERS if self.order is None else self.order
        return tuple(
            whitening_filters(
                [residual[motor] for residual in residuals], [part[motor] for part in counted], most, self.order
            )
            for motor in range(kernel.model.dof)
        )

    def _whitened(self, runs: Sequence[Prepared], plain: Reduction, filters: tuple[FloatArray, ...]) -> Reduction:
        """The plain equations, whitened."""
        kernel = self.setup.kernel
        sums = [QrAccumulator(len(joint.columns) + 1) for joint in plain.joints]
        for run in runs:
            for segment in run.segments:
                for rows in WhitenedRows(kernel, segment, run.parallel_filter, filters):
                    if plain.joints[rows.motor].rows:
                        sums[rows.motor].add(np.vstack([rows.regressor, rows.torque]))
        return replace(
            plain,
            joints=tuple(
                JointFactor(joint.columns, part.factor(), part.rows)
                for joint, part in zip(plain.joints, sums, strict=True)
            ),
            method="QR of whitened blocks",
        )


def _estimator(options: MlOptions, setup: Setup) -> Estimator:
    return MlEstimator(setup, weighted_least_squares, options.order)


METHOD = Method(
    "maximum likelihood with autoregressive noise of each joint's torque",
    "torque",
    MlOptions,
    _estimator,
)
