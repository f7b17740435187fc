"""Whether further friction terms are worth it for the model that is delivered, the physically consistent one.

The unconstrained model may turn friction into what no arm has, and predict well; the consistent one cannot follow. So
both friction models are fitted to the data without one block after the other, made consistent, and compared on that
block, on every equation of motors that move, velocity reversals included.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from ident.estimators.feasible.consistent import found_consistent
from ident.identify.friction.candidates import FOLDS, solve_columns, squared_error
from ident.identify.friction.rows import FrictionRows
from ident.model.base_parameters import BaseParameters
from ident.model.dynamic_model import DynamicModel
from ident.regression.estimate import Estimate, estimate_of
from ident.regression.least_squares import LeastSquares
from ident.regression.observation_matrix import Reduction


def delivered_errors(
    rows: FrictionRows,
    model: DynamicModel,
    base: BaseParameters,
    reduction: Reduction,
    solution: LeastSquares,
    robot_file: RobotFile,
    weights: FloatArray,
    folds: Sequence[npt.NDArray[np.int64]],
) -> FloatArray:
    """Squared error (FOLDS,) of the consistent model on each block of the data that it was not fitted to.

    Args:
        rows: the data.
        model: with its friction settled.
        base: its base parameters.
        reduction: its system on all data.
        solution: of it.
        robot_file: for the consistent model.
        weights: (n,) of the motors' equations; the same for models that are compared.
        folds: block (M,) of each filtered sample, an array per segment of all runs; the error of an empty one is 0.
    """
    sums = rows.fold_sums(model, base, folds)
    fitted = np.einsum("m,fmij->fij", np.square(weights), sums.fitted)
    compared = np.einsum("m,fmij->fij", np.square(weights), sums.compared)
    count = max(1, solution.rows - len(solution.active))
    whole = estimate_of(reduction, solution, np.eye(len(solution.active)), FOLDS)
    errors = []
    for own, judged in zip(fitted, compared, strict=True):
        if not np.any(own):  # fewer runs than folds
            errors.append(0.0)
            continue
        rest = fitted.sum(axis=0) - own
        values = solve_columns(rest, solution.active)
        if values is None:
            return np.full(FOLDS, np.inf)
        consistent = found_consistent(model, base, _estimate(rest, values, whole, count), robot_file)
        errors.append(squared_error(judged, values if consistent is None else consistent.base))
    return np.array(errors)


def falls(before: FloatArray, after: FloatArray) -> bool:
    """Whether errors (FOLDS,) on held-out blocks fall on average by more than the standard error of that average.

    The one-standard-error rule: of models that predict alike, the simpler one (Breiman et al., Classification and
    Regression Trees, 1984, §3.4.3).
    """
    if not np.all(np.isfinite(after)):
        return False
    gain = before - after
    return bool(np.mean(gain) > np.std(gain, ddof=1) / np.sqrt(len(gain)))


def _estimate(gram: FloatArray, values: FloatArray, whole: Estimate, count: int) -> Estimate:
    """The estimate (b,) that a Gram matrix (b + 1, b + 1) gives, with `whole`'s unexcited parameters."""
    active = list(whole.active)
    deviation = np.sqrt(max(squared_error(gram, values) / count, np.finfo(float).tiny))
    root = np.linalg.cholesky(gram[np.ix_(active, active)]).T / deviation
    covariance = np.linalg.inv(root.T @ root)
    return Estimate(whole.active, values[active], root, covariance, whole.taken_up, FOLDS)
