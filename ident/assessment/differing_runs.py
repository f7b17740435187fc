"""Do several recordings show the same bodies? One with another tool, gain or zero fits alone and not with the others.

Friction may change from run to run, bodies may not. So friction is each run's own, and bodies are once those of all
runs together and once each run's own: where the second leaves far less residual, no arm explains all of the runs.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.text import rounded
from ident.friction.table import FRICTION_KINDS
from ident.linear_algebra.triangular import triangular
from ident.model.base_parameters import BaseParameters
from ident.regression.least_squares import LeastSquares, excited_columns, weighted_least_squares
from ident.regression.observation_matrix import Reduction
from ident.verdict.catalogue import raised
from ident.verdict.check import Check

DIFFERENT = 2.0
"""Residual (root mean square) with common bodies over that with each run's own. What a model lacks makes 1.0 to 1.2 of
it on parts of the public recordings; a load of 5 % of the arm's mass in one of two runs makes 4 and more."""

ALONE = 1.3
"""The same with one run's bodies apart, over that with each run's own, up to which this run alone differs."""

LEAST_FREEDOM = 0.5
"""Share of the independent equations that must be left where each run has its own bodies."""


def differing_run_checks(
    labels: Sequence[str],
    runs: Sequence[Reduction],
    base: BaseParameters,
    solution: LeastSquares,
    independent: Sequence[float],
) -> list[Check]:
    """Compare the bodies that single runs show.

    Args:
        labels: names of the runs.
        runs: their equations.
        base: columns of these.
        solution: of the identification.
        independent: share of each run's equations that the filter leaves independent of each other.
    """
    friction = [column for column in solution.active if base.kinds[column] in FRICTION_KINDS]
    bodies = [column for column in solution.active if column not in friction]
    weights = _weights(runs, solution)
    factors = [_without_friction(run, friction, bodies, weights) for run in runs]
    together, apart = _residual(np.vstack(factors)), sum(_residual(factor) for factor in factors)
    equations = sum(share * run.rows for share, run in zip(independent, runs, strict=True))
    freedom = equations - len(runs) * len(solution.active)
    if len(runs) < 2 or freedom < LEAST_FREEDOM * equations or together < DIFFERENT**2 * apart:
        return []
    freed = [
        _residual(np.vstack([other for place, other in enumerate(factors) if place != run])) + _residual(factors[run])
        for run in range(len(runs))
    ]
    alone = int(np.argmin(freed))
    which = f"{labels[alone]} shows different bodies from the other recordings"
    if len(runs) == 2 or freed[alone] > ALONE**2 * apart:
        which = f"{', '.join(labels)} show different bodies"
    times = np.sqrt(together / max(apart, np.finfo(float).tiny))
    text = (
        f"{which}: with common ones the residual is {rounded(times)} times that with each recording's own, friction "
        "aside; the tool, load, a gain or a joint zero differs: do not identify from them together, or validate one "
        "with the other"
    )
    return [raised("recordings-differ", text)]


def _weights(runs: Sequence[Reduction], solution: LeastSquares) -> FloatArray:
    """Weights (n,) of the joints by what each run's own parameters leave of them; 0 of joints that are not used."""
    squares, rows = np.zeros(len(runs[0].joints)), np.zeros(len(runs[0].joints))
    for run in runs:
        own = weighted_least_squares(run, [column for column in excited_columns(run) if column in solution.active])
        squares += run.residual_sums(own.parameters)
        rows += [joint.rows for joint in run.joints]
    return np.asarray(np.sqrt(np.divide(rows, squares, out=np.zeros_like(rows), where=squares > 0.0)))


def _without_friction(
    run: Reduction, friction: Sequence[int], bodies: Sequence[int], weights: FloatArray
) -> FloatArray:
    """Return what is left of a run for bodies and torque (s + 1, s + 1) with the best friction for any bodies."""
    stacked = run.stacked(weights)
    factor = triangular(stacked[:, [*friction, *bodies, run.column_count]])
    return factor[len(friction) :, len(friction) :]


def _residual(factor: FloatArray) -> float:
    """Sum of squares that the best bodies leave; (m, s + 1)."""
    return float(triangular(factor)[-1, -1] ** 2)
