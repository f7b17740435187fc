"""Least squares under linear inequalities (Lawson and Hanson, Solving Least Squares Problems, chapter 23)."""

from __future__ import annotations

import numpy as np

from drivers.core.arrays import FloatArray

ITERATIONS_PER_ROW = 30


def least_squares_within(factor: FloatArray, target: FloatArray, conditions: FloatArray) -> FloatArray | None:
    """The x of least ‖R·x − d‖ among those with G·x ≥ 0; None where rounding keeps it from being found.

    With y = R·x − d this is a least-distance problem, whose dual is a non-negative least-squares problem.

    Args:
        factor: R (b, b), triangular, of full rank.
        target: d (b,).
        conditions: G (c, b).
    """
    from scipy.linalg import solve_triangular
    from scipy.optimize import nnls

    if not len(conditions):
        return np.asarray(solve_triangular(factor, target))
    rows = solve_triangular(factor, conditions.T, trans="T").T
    length = np.linalg.norm(rows, axis=1)
    rows, length = rows[length > 0.0], length[length > 0.0]
    rows = rows / length[:, None]
    bound = -rows @ target
    if np.all(bound <= 0.0):
        return np.asarray(solve_triangular(factor, target))
    size = float(np.max(np.abs(bound)))
    dual = np.vstack([rows.T, bound / size])
    unit = np.zeros(len(dual))
    unit[-1] = 1.0
    try:
        weights, _ = nnls(dual, unit, maxiter=ITERATIONS_PER_ROW * len(dual))
    except RuntimeError:
        return None
    rest = dual @ weights - unit
    if not abs(rest[-1]) > np.finfo(np.float64).eps:
        return None
    return np.asarray(solve_triangular(factor, target - size * rest[:-1] / rest[-1]))
