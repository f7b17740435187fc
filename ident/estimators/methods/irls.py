"""Iteratively reweighted least squares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from pydantic import Field

from drivers.core.arrays import FloatArray
from ident.estimators.estimator import Estimation, EstimationLoop, Estimator, Setup
from ident.estimators.feasible.consistent import found_consistent
from ident.estimators.method import Method
from ident.estimators.robust.reweighting import COVARIANCE_TOLERANCE, PARAMETER_TOLERANCE, Reweighting, RobustFit, Solve
from ident.estimators.robust.weight_functions import WeightFunction, WeightName, weight_function
from ident.estimators.robust.whitened_equations import Whitening, sample_equations, whitened
from ident.estimators.torque_estimator import reduce_torques
from ident.model.regressor import RegressorKernel
from ident.regression.comparison import independent_share
from ident.regression.estimate import estimate_of
from ident.regression.jackknife import CorrectedCovariance, FilteredRun, motion_blocks, tolerant_moves
from ident.regression.least_squares import LeastSquares, ordinary_least_squares
from ident.regression.observation_matrix import Reduction
from ident.signals.prepared import Prepared, Step

LEAST_HOLD = 0.5
"""Least eigenvalue of Σψ′(z)·xxᵀ relative to Σw·xxᵀ. Few equations are near the threshold, so that smaller ones are
themselves uncertain: error bars grow at most twofold by weights that move."""


def whitened_jackknife(
    estimation: Estimation, runs: Sequence[FilteredRun], torques: Sequence[int], function: WeightFunction
) -> CorrectedCovariance:
    """Corrected covariance of the active parameters of a whitened and weighted system.

    Weights move with the data: where equations are about to be rejected, the others hold the estimate less than the
    weighted system Σw·xxᵀ does. The moves are those of Σψ′(z)·xxᵀ (Huber, Annals of Statistics 1, 1973).

    Args:
        estimation: with its weights and Ω.
        runs: the data.
        torques: motors whose torques are used.
        function: of the weights.
    """
    kernel, solution, active = estimation.kernel, estimation.solution, list(estimation.solution.active)
    whitening = Whitening(estimation.joint_covariance)
    blocks = motion_blocks([torques_of for run in runs for torques_of in run.series])
    sums, of_segments, weights = blocks.sums(len(active)), iter(blocks.of_segments), iter(estimation.weights)
    holding = np.zeros((len(active), len(active)))
    for run in runs:
        for segment in run.segments:
            of_segment, weight = next(of_segments), next(weights)
            for sample_equation in sample_equations(kernel, segment, run.parallel_filter, torques):
                _, unroot = whitening.roots(sample_equation.motors)
                weight_of = weight[np.ix_(np.array(sample_equation.motors), sample_equation.samples)]
                of_sample = of_segment[sample_equation.samples]
                regressor, residual = (
                    sample_equation.regressor[:, active],
                    sample_equation.residual(solution.parameters),
                )
                for block in np.unique(of_sample).tolist():
                    inside = of_sample == block
                    rows = whitened(regressor[:, :, inside], residual[:, inside], unroot, np.ones(1))
                    weighted = weight_of[:, inside].ravel() * rows[:-1]
                    sums.gram[block] += weighted @ rows[:-1].T
                    sums.score[block] += weighted @ rows[-1]
                    holding += function.slope(rows[-1]) * rows[:-1] @ rows[:-1].T
    normal = sums.gram.sum(axis=0)
    moves = tolerant_moves(sums, normal) @ loosened(normal, holding)
    share = independent_share(blocks.autocorrelation[list(torques)])
    return blocks.corrected(moves, solution.rows, share)


def loosened(normal: FloatArray, holding: FloatArray) -> FloatArray:
    """N·H⁻¹ (a, a) of N = Σw·xxᵀ and H = Σψ′(z)·xxᵀ, H held above `LEAST_HOLD` of N."""
    lengths = np.sqrt(np.diag(normal))
    pairs = np.outer(lengths, lengths)
    values, vectors = np.linalg.eigh(normal / pairs)
    root = vectors * np.sqrt(np.maximum(values, np.finfo(float).eps * values[-1]))
    inverse = np.linalg.inv(root)
    held, directions = np.linalg.eigh(inverse @ (holding / pairs) @ inverse.T)
    freed = root @ (directions / np.maximum(held, LEAST_HOLD) @ directions.T) @ inverse
    return np.asarray(lengths[:, None] * freed / lengths)


def consistent_or_free(setup: Setup, active: Sequence[int]) -> Solve:
    """Least squares whose parameters are replaced by the consistent ones that fit the same system best.

    Where no consistent ones are found, those of least squares stay; the identification reports that at its end.
    """

    def solve(kernel: RegressorKernel, reduction: Reduction, before: FloatArray) -> LeastSquares:
        free = ordinary_least_squares(reduction, active)
        estimate = estimate_of(reduction, free, free.covariance, 0)
        feasible = found_consistent(kernel.model, setup.base, estimate, setup.robot_file)
        if feasible is None:
            return free
        parameters = free.parameters.copy()
        parameters[list(active)] = feasible.base[list(active)]
        return replace(free, parameters=parameters)

    return solve


@dataclass(frozen=True)
class RobustEstimator:
    """IRLS on the joints' torque equations."""

    setup: Setup  # the data
    weights: WeightName  # name of the weight function
    consistent: bool  # whether residuals, weights and Ω are those of the physically consistent parameters

    def notes(self, run: Prepared) -> tuple[Step, ...]:
        """Nothing that is not in the list."""
        return ()

    def reduce(self, runs: Sequence[Prepared]) -> Reduction:
        """One factor per joint."""
        return reduce_torques(self.setup.kernel, runs, self.setup.experiment.torques)

    def estimate(self, runs: Sequence[Prepared], plain: Reduction, active: Sequence[int]) -> Estimation:
        """Iterate from weighted least squares until Ω and the weights settle."""
        loops = reweighting(self.setup, self.weights, runs, plain, active, self.solver(active))
        return estimation(loops.started(self.setup.kernel, plain), loops, "irls")

    def solver(self, active: Sequence[int]) -> Solve:
        """Least squares, or what is physically consistent of it."""
        if self.consistent:
            return consistent_or_free(self.setup, active)
        return lambda kernel, reduction, before: ordinary_least_squares(reduction, active)

    def covariance(self, runs: Sequence[FilteredRun], estimation: Estimation) -> CorrectedCovariance:
        """Delete-block jackknife on the whitened equations with the last weights."""
        function = weight_function(self.weights, estimation.solution.rows - len(estimation.solution.active))
        return whitened_jackknife(estimation, runs, self.setup.experiment.torques, function)

    def restricted(self, estimation: Estimation, columns: Sequence[int]) -> LeastSquares:
        """Least squares with the last weights and Ω."""
        return replace(ordinary_least_squares(estimation.reduction, columns), method=estimation.solution.method)


def reweighting(
    setup: Setup, weights: WeightName, runs: Sequence[Prepared], plain: Reduction, active: Sequence[int], solve: Solve
) -> Reweighting:
    """The inner loops on these data."""
    function = weight_function(weights, plain.rows - len(active))
    return Reweighting.of(runs, setup.experiment.torques, plain, active, function, solve)


def estimation(fit: RobustFit, loops: Reweighting, method: str) -> Estimation:
    """Return what the inner loops ended with, as an estimator gives it: least squares of the last whitened system."""
    solution = ordinary_least_squares(fit.done.reduction, loops.active)
    settled = loops.changes[-1] < COVARIANCE_TOLERANCE, loops.steps[-1] < PARAMETER_TOLERANCE
    return Estimation(
        kernel=fit.kernel,
        reduction=fit.done.reduction,
        solution=replace(
            solution,
            method=method,
            joint_std=np.sqrt(np.diag(fit.covariance)),
            iterations=len(loops.steps),
            settled=fit.settled,
        ),
        loops=(
            EstimationLoop("covariance of the joints, relative change", "", tuple(loops.changes), settled[0]),
            EstimationLoop("weights, largest step of a parameter", "σ", tuple(loops.steps), settled[1]),
        ),
        weights=fit.done.weights,
        passes=loops.passes,
        joint_covariance=fit.covariance,
    )


@dataclass(frozen=True)
class IrlsOptions:
    """Options of IRLS."""

    weights: Annotated[WeightName, Field(description="how large residuals are weighted: not at all, or less")] = "hard"
    consistent: Annotated[bool, Field(description="weigh by the residuals of the physically consistent parameters")] = (
        False
    )


def _estimator(options: IrlsOptions, setup: Setup) -> Estimator:
    return RobustEstimator(setup, options.weights, options.consistent)


METHOD = Method(
    "robust: equations whitened across the joints, samples with large residuals rejected or down-weighted",
    "torque",
    IrlsOptions,
    _estimator,
)
