"""Error bars of whitened and weighted equations, for autocorrelated residuals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.estimators.estimator import Estimation
from ident.estimators.robust.whitened_equations import Whitening, sample_equations, whitened
from ident.regression.autocorrelation import independent_share, residual_autocorrelation
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
                regressor, residual = part.regressor[:, active], part.residual(solution.parameters)
                for block in np.unique(of_sample).tolist():
                    inside = of_sample == block
                    rows = whitened(regressor[:, :, inside], residual[:, inside], unroot, root_weight[:, inside])
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
