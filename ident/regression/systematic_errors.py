"""What a delay that is not taken out and sticking near velocity reversals may have done to an estimate.

The jackknife sees errors that change from block to block. Two that come back with every period of the motion it does
not see: a torque that lags by less than `dynid` corrects (a gravity torque that turns with the joint then looks like
viscous friction), and equations near reversals, where static friction is wrong. Both leave a trace in the data: the
delay's own estimate, and how far the parameters move without those equations. Their squares are added to the
covariance, as the essential model's has the square of what the pruning changed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import IdentificationError
from ident.model.regressor import RegressorKernel
from ident.regression.jackknife import CorrectedCovariance
from ident.regression.least_squares import excited_columns, solve_weighted
from ident.regression.observation_matrix import Reduction, only_torques, reduce_segments, stack_reductions
from ident.regression.velocity_reversals import without_reversals
from ident.signals.prepared import Prepared


def with_systematic_errors(
    corrected: CorrectedCovariance,
    kernel: RegressorKernel,
    runs: Sequence[Prepared],
    reduction: Reduction,
    weights: FloatArray,
    active: Sequence[int],
    torques: Sequence[int],
    delay: float,
) -> CorrectedCovariance:
    """The covariance with what both errors may have done to the parameters.

    Args:
        corrected: by the jackknife.
        kernel: of the base columns.
        runs: the data.
        reduction: of them.
        weights: (n,) of the motors' equations.
        active: base columns that were estimated (a).
        torques: motors whose equations count.
        delay: root mean square of the delay that is still in the data [s]; 0 where the delay is known.
    """
    chosen, total = list(active), corrected.covariance
    before = solve_weighted(reduction, active, weights, "wls", 1).parameters
    parts = [without_reversals(kernel, run) for run in runs]
    away = only_torques(
        stack_reductions([reduce_segments(kernel, run.segments, run.parallel_filter) for run in parts]), torques
    )
    if set(chosen) <= set(excited_columns(away)):
        try:
            moved = (solve_weighted(away, active, weights, "wls", 1).parameters - before)[chosen]
            total = total + np.outer(moved, moved)
        except IdentificationError:  # too little is left to compare with
            pass
    if delay > 0.0:
        changes = []
        for run in runs:
            slopes = [np.gradient(segment.torque, axis=1) * segment.rate for segment in run.segments]
            changes.append(reduce_segments(kernel, run.segments, run.parallel_filter, slopes))
        lagging = only_torques(stack_reductions(changes), torques)
        moved = delay * solve_weighted(lagging, active, weights, "wls", 1).parameters[chosen]
        total = total + np.outer(moved, moved)
    return replace(corrected, covariance=total, random_std=np.sqrt(np.diag(corrected.covariance)))
