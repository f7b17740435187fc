"""Iteratively reweighted least squares across the joints (AUBO .2.3; Han et al. 2020).

Two loops: the inner one iterates the covariance Ω of the joints' residuals (eq. 14), the second one the weights of the
normalised residuals (eq. 12). Nesting them costs a pass over the data for every step of the inner loop; here they run
in step, one update of both per pass, which has the same fixed points. Ω starts from the median absolute deviations of
the weighted least squares' residuals, which outliers do not reach.

Rejected residuals take variance with them: Ω is divided by what the weights leave of a normal variance, so that it
stays that of the accepted residuals' noise and hard weights do not narrow themselves (eq. 14 has no such factor).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.streams import FloatArray
from ident.estimators.estimator import Estimation, Loop, Setup
from ident.estimators.robust.weight_functions import WeightFunction, WeightName, weight_function
from ident.estimators.robust.whitened_equations import CovarianceSums, Whitening, sample_equations
from ident.estimators.torque_estimator import reduce_torques
from ident.linear_algebra.triangular import PreconditionedGram
from ident.model.regressor import RegressorKernel
from ident.regression.autocorrelation import independent_share, lag_one, residual_autocorrelation
from ident.regression.jackknife import (
    BlockSums,
    CorrectedCovariance,
    FilteredRun,
    block_count,
    block_length,
    distinct_samples,
    jackknife_covariance,
    tolerant_moves,
)
from ident.regression.least_squares import (
    LeastSquares,
    ordinary_least_squares,
    rounding_floor,
    weighted_least_squares,
)
from ident.regression.observation_matrix import JointFactor, Reduction
from ident.signals.prepared import Prepared, Step

MAD_TO_STD = 1.4826
"""Standard deviation of normal residuals over the median of their absolute values."""

COVARIANCE_TOLERANCE = 1e-3
"""Largest relative change of Ω, to the joints' variances, at which it has settled."""

PARAMETER_TOLERANCE = 1e-2
"""Largest step of a parameter, in its classical standard deviations, at which the weights have settled."""

MOST_PASSES = 40


@dataclass(frozen=True, eq=False)
class Pass:
    """What one pass over the data gives.

    Attributes:
        reduction: of the whitened and weighted equations.
        weights: for each segment (n, M), nan where an equation takes no part.
        normalised: residuals of the parameters that the pass began with, likewise.
        sums: for the next Ω.
    """

    reduction: Reduction
    weights: tuple[FloatArray, ...]
    normalised: tuple[FloatArray, ...]
    sums: CovarianceSums


@dataclass(frozen=True)
class RobustEstimator:
    """IRLS on the joints' torque equations.

    Attributes:
        setup: the data.
        weights: name of the weight function.
    """

    setup: Setup
    weights: WeightName

    def notes(self, run: Prepared) -> tuple[Step, ...]:
        """Nothing that is not in the list."""
        return ()

    def reduce(self, runs: Sequence[Prepared]) -> Reduction:
        """One factor per joint."""
        return reduce_torques(self.setup.kernel, runs, self.setup.experiment.torques)

    def estimate(self, runs: Sequence[Prepared], plain: Reduction, active: Sequence[int]) -> Estimation:
        """Iterate from weighted least squares until Ω and the weights settle."""
        kernel, torques = self.setup.kernel, self.setup.experiment.torques
        solution = weighted_least_squares(plain, active)
        freedom = max(1.0, plain.rows - len(active))
        floor = rounding_floor(plain)
        function = weight_function(self.weights, freedom)
        factor = plain.rows / freedom / function.variance
        start = np.where(solution.joint_std > 0, np.maximum(solution.joint_std, floor), 1.0)
        first = weighted_pass(kernel, runs, torques, plain, solution.parameters, np.diag(start**2), None)
        independent = independent_samples(first.normalised, torques) - len(active) / len(torques)
        covariance = np.diag(np.maximum(start * median_deviations(first.normalised), floor) ** 2)
        changes: list[float] = []
        steps: list[float] = []
        settled = False
        while not settled and len(steps) < MOST_PASSES:
            done = weighted_pass(kernel, runs, torques, plain, solution.parameters, covariance, function)
            refined = ordinary_least_squares(done.reduction, active)
            step = np.abs(refined.parameters - solution.parameters)[list(active)]
            steps.append(float(np.max(step / np.sqrt(np.diag(refined.covariance)), initial=0.0)))
            solution = refined
            updated = done.sums.covariance(factor, independent, floor)
            changes.append(relative_change(covariance, updated))
            covariance = updated
            settled = steps[-1] < PARAMETER_TOLERANCE and changes[-1] < COVARIANCE_TOLERANCE
        return Estimation(
            kernel=kernel,
            reduction=done.reduction,
            solution=replace(
                solution,
                method="irls",
                joint_std=np.sqrt(np.diag(covariance)),
                iterations=len(steps),
                settled=settled,
            ),
            loops=(
                Loop(
                    "covariance across joints, relative change", "", tuple(changes), changes[-1] < COVARIANCE_TOLERANCE
                ),
                Loop("weights, largest step of a parameter", "σ", tuple(steps), steps[-1] < PARAMETER_TOLERANCE),
            ),
            weights=done.weights,
            passes=2 + len(steps),
            joint_covariance=covariance,
        )

    def covariance(self, runs: Sequence[FilteredRun], estimation: Estimation) -> CorrectedCovariance:
        """Delete-block jackknife on the whitened equations with the last weights."""
        function = weight_function(self.weights, estimation.solution.rows - len(estimation.solution.active))
        return whitened_jackknife(estimation, runs, self.setup.experiment.torques, function.steepness)

    def restricted(self, estimation: Estimation, columns: Sequence[int]) -> LeastSquares:
        """Least squares with the last weights and Ω."""
        return replace(ordinary_least_squares(estimation.reduction, columns), method="irls")


def weighted_pass(
    kernel: RegressorKernel,
    runs: Sequence[Prepared],
    torques: Sequence[int],
    plain: Reduction,
    parameters: FloatArray,
    covariance: FloatArray,
    function: WeightFunction | None,
) -> Pass:
    """Whiten, weigh and reduce all equations once.

    Args:
        kernel: for the base columns (b).
        runs: the data.
        torques: motors whose torques are used.
        plain: their equations, reduced: the preconditioner.
        parameters: (b,) whose residuals are weighed.
        covariance: Ω (n, n).
        function: of the weights; all equations count alike where None.
    """
    whitening, sums = Whitening(covariance), CovarianceSums(kernel.model.dof)
    deviations = np.sqrt(np.diag(covariance))
    inverse = np.array([1.0 / deviations[n] if joint.rows else 0.0 for n, joint in enumerate(plain.joints)])
    accumulator = PreconditionedGram(plain.stacked(inverse), plain.rows)
    all_weights, all_normalised = [], []
    rows = samples = 0
    for run in runs:
        for segment in run.segments:
            count = len(segment.used[:: run.parallel_filter.factor])
            weights, normalised = (np.full((kernel.model.dof, count), np.nan) for _ in range(2))
            for part in sample_equations(kernel, segment, run.parallel_filter, torques):
                root, unroot = whitening.roots(part.motors)
                residual = unroot @ part.residual(parameters)
                weight = np.ones_like(residual) if function is None else function(residual)
                place = np.ix_(np.array(part.motors), part.samples)
                weights[place], normalised[place] = weight, residual
                sums.add(part.motors, root, residual, weight)
                accumulator.add(_whitened(part.regressor, part.torque, unroot, np.sqrt(weight)))
                rows += int(np.count_nonzero(weight))
                samples += len(part.samples)
            all_weights.append(weights)
            all_normalised.append(normalised)
    columns = tuple(range(len(kernel.columns)))
    reduction = Reduction(
        joints=(JointFactor(columns, accumulator.factor(), rows),),
        column_count=len(columns),
        torque_count=1,
        samples=samples,
        method="preconditioned Gram matrix of the whitened equations",
    )
    return Pass(reduction, tuple(all_weights), tuple(all_normalised), sums)


def _whitened(regressor: FloatArray, torque: FloatArray, unroot: FloatArray, root_weight: FloatArray) -> FloatArray:
    """Rows (b + 1, k·m) of the whitened and weighted system."""
    equations = np.concatenate([regressor, torque[:, None]], axis=1)
    mixed = np.einsum("kj,jbm->bkm", unroot, equations, optimize=True) * root_weight
    return np.asarray(mixed.reshape(equations.shape[1], -1))


def median_deviations(normalised: Sequence[FloatArray]) -> FloatArray:
    """Standard deviation (n,) of each joint's residuals by their median absolute value; 1 where there are none."""
    sizes = np.abs(np.concatenate(normalised, axis=1))
    return np.array([MAD_TO_STD * np.median(of[~np.isnan(of)]) if np.any(~np.isnan(of)) else 1.0 for of in sizes])


def independent_samples(normalised: Sequence[FloatArray], torques: Sequence[int]) -> float:
    """Number of independent samples that the residuals of a joint are worth, mean over the joints."""
    known = [np.where(np.isnan(part), 0.0, part)[list(torques)] for part in normalised]
    samples = sum(int(np.sum(~np.isnan(part[list(torques)]))) for part in normalised) / max(1, len(torques))
    return samples * independent_share(lag_one(known))


def relative_change(before: FloatArray, after: FloatArray) -> float:
    """Largest change of an entry of Ω (n, n), relative to the joints' standard deviations."""
    deviations = np.sqrt(np.diag(after))
    return float(np.max(np.abs(after - before) / np.outer(deviations, deviations)))


def whitened_jackknife(
    estimation: Estimation, runs: Sequence[FilteredRun], torques: Sequence[int], steepness: float
) -> CorrectedCovariance:
    """Corrected covariance of the active parameters of a whitened and weighted system.

    Args:
        estimation: with its weights and Ω.
        runs: the data.
        torques: motors whose torques are used.
        steepness: E[w]/E[ψ′], since the weights move with the data.
    """
    kernel, solution, active = estimation.kernel, estimation.solution, list(estimation.solution.active)
    whitening = Whitening(estimation.joint_covariance)
    series = [torques_of for run in runs for torques_of in run.series]
    autocorrelation = residual_autocorrelation(series)
    samples = distinct_samples(series)
    length = block_length(autocorrelation, samples.count)
    sums = BlockSums.empty(block_count(samples.count, length), len(active))
    indices, weights = iter(samples.indices), iter(estimation.weights)
    for run in runs:
        for segment in run.segments:
            blocks, weight = next(indices) // length, next(weights)
            for part in sample_equations(kernel, segment, run.parallel_filter, torques):
                _, unroot = whitening.roots(part.motors)
                root_weight = np.sqrt(weight[np.ix_(np.array(part.motors), part.samples)])
                of_sample = blocks[part.samples]
                residual = part.residual(solution.parameters)
                for block in np.unique(of_sample).tolist():
                    inside = of_sample == block
                    rows = _whitened(
                        part.regressor[:, active][:, :, inside],
                        residual[:, inside],
                        unroot,
                        root_weight[:, inside],
                    )
                    sums.gram[block] += rows[:-1] @ rows[:-1].T
                    sums.score[block] += rows[:-1] @ rows[-1]
    moves = steepness * tolerant_moves(sums, sums.gram.sum(axis=0))
    return CorrectedCovariance(
        covariance=jackknife_covariance(moves),
        block_length=length,
        blocks=len(sums.gram),
        autocorrelation=autocorrelation,
        effective_rows=solution.rows * independent_share(autocorrelation[list(torques)]) * samples.share,
        repetitions=1.0 / samples.share,
    )
