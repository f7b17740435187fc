"""Error bars of whitened and weighted equations, for autocorrelated residuals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.estimators.estimator import Estimation
from ident.estimators.robust.whitened_equations import Whitening, sample_equations, whitened
from ident.regression.autocorrelation import independent_share
from ident.regression.jackknife import CorrectedCovariance, FilteredRun, motion_blocks, tolerant_moves


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
    blocks = motion_blocks([torques_of for run in runs for torques_of in run.series])
    sums, of_segments, weights = blocks.sums(len(active)), iter(blocks.of_segments), iter(estimation.weights)
    for run in runs:
        for segment in run.segments:
            of_segment, weight = next(of_segments), next(weights)
            for part in sample_equations(kernel, segment, run.parallel_filter, torques):
                _, unroot = whitening.roots(part.motors)
                root_weight = np.sqrt(weight[np.ix_(np.array(part.motors), part.samples)])
                of_sample = of_segment[part.samples]
                regressor, residual = part.regressor[:, active], part.residual(solution.parameters)
                for block in np.unique(of_sample).tolist():
                    inside = of_sample == block
                    rows = whitened(regressor[:, :, inside], residual[:, inside], unroot, root_weight[:, inside])
                    sums.gram[block] += rows[:-1] @ rows[:-1].T
                    sums.score[block] += rows[:-1] @ rows[-1]
    moves = steepness * tolerant_moves(sums, sums.gram.sum(axis=0))
    share = independent_share(blocks.autocorrelation[list(torques)])
    return blocks.corrected(moves, solution.rows, share)
