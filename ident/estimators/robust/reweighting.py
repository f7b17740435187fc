"""The two inner loops: the covariance Ω across the joints, and the weights of the equations (AUBO .2.3).

Nested, every step of the inner loop costs a pass over the data; here they run in step, one update of both per pass,
which has the same fixed points. Ω starts from the median absolute deviations of the weighted least squares' residuals,
which outliers do not reach.

Rejected residuals take variance with them: Ω is divided by what the weights leave of a normal variance, so that it
stays that of the accepted residuals' noise and hard weights do not narrow themselves (eq. 14 has no such factor).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from drivers.core.arrays import FloatArray
from ident.estimators.robust.weight_functions import WeightFunction
from ident.estimators.robust.whitened_equations import CovarianceSums, Whitening, sample_equations, whitened
from ident.linear_algebra.triangular import QrAccumulator
from ident.model.regressor import RegressorKernel
from ident.regression.comparison import independent_share, lag_one
from ident.regression.least_squares import LeastSquares, rounding_floor, weighted_least_squares
from ident.regression.observation_matrix import JointFactor, Reduction
from ident.signals.prepared import Prepared

ROWS_AT_ONCE = 4096
"""Rows that are collected before they are added to the triangular factor."""

MAD_TO_STD = 1.4826
"""Standard deviation of normal residuals over the median of their absolute values."""

COVARIANCE_TOLERANCE = 1e-3
"""Largest relative change of Ω, to the joints' variances, at which it has settled."""

PARAMETER_TOLERANCE = 1e-2
"""Largest step of a parameter, in its classical standard deviations, at which the weights have settled."""

MOST_PASSES = 40

LEAST_WEIGHT = 0.5
"""Weight from which an equation counts in the plain statistics of a robust estimate (`without_rejected`)."""

Solve = Callable[[RegressorKernel, Reduction, FloatArray], LeastSquares]
"""The solution of a reduced system, after the parameters (b,) of the last one; what its residuals are those of."""


@dataclass(frozen=True, eq=False)
class Pass:
    """What one pass over the data gives."""

    reduction: Reduction  # of the whitened and weighted equations
    weights: tuple[FloatArray, ...]  # for each segment (n, M), nan where an equation takes no part
    residuals: tuple[FloatArray, ...]  # of the parameters that the pass began with, likewise [N·m]
    sums: CovarianceSums  # for the next Ω


def weighted_pass(
    kernel: RegressorKernel,
    runs: Sequence[Prepared],
    torques: Sequence[int],
    parameters: FloatArray,
    covariance: FloatArray,
    function: WeightFunction | None,
) -> Pass:
    """Whiten, weigh and reduce all equations once.

    Args:
        kernel: for the base columns (b).
        runs: the data.
        torques: motors whose torques are used.
        parameters: (b,) whose residuals are weighed.
        covariance: Ω (n, n).
        function: of the weights; all equations count alike where None.
    """
    whitening, sums = Whitening(covariance), CovarianceSums(kernel.model.dof)
    accumulator = _Collected(len(kernel.columns) + 1)
    all_weights, all_residuals = [], []
    rows = samples = 0
    for run in runs:
        for segment in run.segments:
            count = len(segment.used[:: run.parallel_filter.factor])
            weights, residuals = (np.full((kernel.model.dof, count), np.nan) for _ in range(2))
            for sample_equation in sample_equations(kernel, segment, run.parallel_filter, torques):
                root, unroot = whitening.roots(sample_equation.motors)
                plain = sample_equation.residual(parameters)
                residual = unroot @ plain
                weight = np.ones_like(residual) if function is None else function(residual)
                place = np.ix_(np.array(sample_equation.motors), sample_equation.samples)
                weights[place], residuals[place] = weight, plain
                sums.add(sample_equation.motors, root, residual, weight)
                accumulator.add(whitened(sample_equation.regressor, sample_equation.torque, unroot, np.sqrt(weight)))
                rows += int(np.count_nonzero(weight))
                samples += len(sample_equation.samples)
            all_weights.append(weights)
            all_residuals.append(residuals)
    columns = tuple(range(len(kernel.columns)))
    reduction = Reduction(
        joints=(JointFactor(columns, accumulator.factor(), rows),),
        column_count=len(columns),
        torque_count=1,
        samples=samples,
        method="QR of the whitened equations",
    )
    return Pass(reduction, tuple(all_weights), tuple(all_residuals), sums)


class _Collected:
    """A triangular factor of many small blocks, which are stacked before they are added."""

    def __init__(self, width: int) -> None:
        self._factor = QrAccumulator(width)
        self._blocks: list[FloatArray] = []

    def add(self, block: FloatArray) -> None:
        self._blocks.append(block)
        if sum(waiting.shape[1] for waiting in self._blocks) >= ROWS_AT_ONCE:
            self._flush()

    def factor(self) -> FloatArray:
        self._flush()
        return self._factor.factor()

    def _flush(self) -> None:
        if self._blocks:
            self._factor.add(np.concatenate(self._blocks, axis=1))
            self._blocks = []


@dataclass(frozen=True, eq=False)
class RobustFit:
    """End of the inner loops."""

    kernel: RegressorKernel  # of the base columns
    done: Pass  # the last pass
    solution: LeastSquares  # of it
    covariance: FloatArray  # Ω (n, n)
    settled: bool  # whether Ω and the weights converged

    @property
    def spread(self) -> float:
        """Geometric mean of the joints' residual standard deviations [N·m]: what falls as the fit improves."""
        used = ~np.isnan(np.concatenate(self.done.weights, axis=1))
        variances = np.diag(self.covariance)[used.any(axis=1)]
        return float(np.exp(0.5 * np.mean(np.log(variances))))

    def loss(self, covariance: FloatArray, function: WeightFunction) -> float:
        """Mean loss of all equations' residuals, those of weight 0 included, whitened by Ω (n, n)."""
        whitening = Whitening(covariance)
        total, count = 0.0, 0
        for residuals in self.done.residuals:
            taking_part = ~np.isnan(residuals)
            patterns, of_sample = np.unique(taking_part, axis=1, return_inverse=True)
            for number, pattern in enumerate(patterns.T):
                if pattern.any():
                    _, unroot = whitening.roots(tuple(np.flatnonzero(pattern).tolist()))
                    losses = function.loss(unroot @ residuals[np.ix_(pattern, of_sample.ravel() == number)])
                    total, count = total + float(np.sum(losses)), count + losses.size
        return total / max(1, count)


@dataclass
class Reweighting:
    """The inner loops on the same data, from any start."""

    runs: Sequence[Prepared]  # the data
    torques: Sequence[int]  # motors whose torques are used
    active: Sequence[int]  # base columns that are estimated
    function: WeightFunction  # of the weights
    solve: Solve  # what the weights are those of
    floor: FloatArray  # (n,) smallest standard deviations
    factor: float  # of all variances: degrees of freedom, and what the weights take
    independent: float = 1.0  # number of independent samples that correlations are estimated from
    passes: int = 1  # over the data so far
    # changes, steps: of Ω and of the parameters, per pass so far
    changes: list[float] = field(default_factory=list)
    steps: list[float] = field(default_factory=list)

    @classmethod
    def of(
        cls,
        runs: Sequence[Prepared],
        torques: Sequence[int],
        plain: Reduction,
        active: Sequence[int],
        function: WeightFunction,
        solve: Solve,
    ) -> Reweighting:
        """Make the weights of a system that is also known as plain equations, one factor per joint."""
        factor = plain.rows / max(1.0, plain.rows - len(active)) / function.variance
        return cls(runs, torques, active, function, solve, rounding_floor(plain), factor)

    def started(self, kernel: RegressorKernel, plain: Reduction) -> RobustFit:
        """Start from weighted least squares of the plain equations.

        Raises:
            IdentificationError: they do not determine the parameters.
        """
        solution = weighted_least_squares(plain, self.active)
        start = np.where(solution.joint_std > 0, np.maximum(solution.joint_std, self.floor), 1.0)
        first = self._pass(kernel, solution.parameters, np.diag(start**2), None)
        self.independent = independent_samples(first.residuals, self.torques) - len(self.active) / len(self.torques)
        deviations = np.maximum(median_deviations(first.residuals), self.floor)
        return self.iterated(kernel, solution.parameters, np.diag(deviations**2))

    def iterated(self, kernel: RegressorKernel, parameters: FloatArray, covariance: FloatArray) -> RobustFit:
        """Iterate from base parameters (b,) and Ω (n, n) until both and the weights settle.

        Raises:
            IdentificationError: the weights leave too few equations.
        """
        active = list(self.active)
        for _ in range(MOST_PASSES):
            done = self._pass(kernel, parameters, covariance, self.function)
            solution = self.solve(kernel, done.reduction, parameters)
            step = np.abs(solution.parameters - parameters)[active]
            self.steps.append(float(np.max(step / np.sqrt(np.diag(solution.covariance)), initial=0.0)))
            parameters = solution.parameters
            updated = done.sums.covariance(self.factor, self.independent, self.floor)
            self.changes.append(relative_change(covariance, updated))
            covariance = updated
            if self.settled:
                break
        return RobustFit(kernel, done, solution, covariance, self.settled)

    @property
    def settled(self) -> bool:
        """Return whether the last pass changed neither Ω nor the parameters."""
        return self.steps[-1] < PARAMETER_TOLERANCE and self.changes[-1] < COVARIANCE_TOLERANCE

    def _pass(
        self, kernel: RegressorKernel, parameters: FloatArray, covariance: FloatArray, function: WeightFunction | None
    ) -> Pass:
        self.passes += 1
        return weighted_pass(kernel, self.runs, self.torques, parameters, covariance, function)


def without_rejected(runs: Sequence[Prepared], weights: Sequence[FloatArray]) -> list[Prepared]:
    """The same data without the equations of which the estimate took less than half; as they are without weights.

    Args:
        runs: the data.
        weights: of the filtered equations of each segment of all runs, in order (n, M); empty where all count alike.
    """
    if not weights:
        return list(runs)
    of_segment, kept = iter(weights), []
    for run in runs:
        segments = []
        for segment in run.segments:
            mask = np.zeros(segment.torque.shape, dtype=np.bool_)
            mask[:, :: run.parallel_filter.factor] = next(of_segment) < LEAST_WEIGHT
            segments.append(replace(segment, reversing=mask if segment.reversing is None else mask | segment.reversing))
        kept.append(replace(run, segments=tuple(segments)))
    return kept


def median_deviations(residuals: Sequence[FloatArray]) -> FloatArray:
    """Standard deviation (n,) of each joint's residuals by their median absolute value; 1 where there are none."""
    sizes = np.abs(np.concatenate(residuals, axis=1))
    return np.array([MAD_TO_STD * np.median(of[~np.isnan(of)]) if np.any(~np.isnan(of)) else 1.0 for of in sizes])


def independent_samples(residuals: Sequence[FloatArray], torques: Sequence[int]) -> float:
    """Number of independent samples that the residuals of a joint are worth, mean over the joints."""
    filled = [np.where(np.isnan(segment), 0.0, segment)[list(torques)] for segment in residuals]
    samples = sum(int(np.sum(~np.isnan(segment[list(torques)]))) for segment in residuals) / max(1, len(torques))
    return samples * independent_share(lag_one(filled))


def relative_change(before: FloatArray, after: FloatArray) -> float:
    """Largest change of an entry of Ω (n, n), relative to the joints' standard deviations."""
    deviations = np.sqrt(np.diag(after))
    return float(np.max(np.abs(after - before) / np.outer(deviations, deviations)))
