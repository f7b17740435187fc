"""Least squares under linear inequalities (Lawson and Hanson, Solving Least Squares Problems, chapter 23)."""

from __future__ import annotations

import numpy as np

from drivers.core.arrays import BoolArray, FloatArray

ITERATIONS_PER_ROW = 30


def nonnegative_least_squares(matrix: FloatArray, target: FloatArray) -> FloatArray | None:
    """The x (k,) of least ‖A·x − b‖ with x ≥ 0, for A (m, k); None where rounding keeps it from being found.

    As `scipy.optimize.nnls`, whose import takes longer than what is solved here.
    """
    solution, positive = np.zeros(matrix.shape[1]), np.zeros(matrix.shape[1], dtype=np.bool_)
    lengths = np.linalg.norm(matrix, axis=0)
    lengths[lengths == 0.0] = 1.0
    matrix = matrix / lengths
    noise = 10.0 * max(matrix.shape) * np.finfo(np.float64).eps * float(np.linalg.norm(target))
    steps = ITERATIONS_PER_ROW * len(matrix)
    while True:
        slope = np.where(positive, -np.inf, matrix.T @ (target - matrix @ solution))
        while True:  # the steepest whose value becomes positive
            if not np.any(slope > noise):
                return np.asarray(solution / lengths)
            entering = int(np.argmax(slope))
            positive[entering] = True
            ahead = _solved_by(matrix, target, positive)
            if ahead[entering] > 0.0:
                break
            positive[entering], slope[entering] = False, -np.inf
        while np.any(blocked := positive & (ahead <= 0.0)):  # as far as the first that reaches 0
            steps -= 1
            if steps < 0:
                return None
            share = solution[blocked] / (solution[blocked] - ahead[blocked])
            solution += share.min() * (ahead - solution)
            positive[np.flatnonzero(blocked)[share == share.min()]] = False
            solution[~positive] = 0.0
            ahead = _solved_by(matrix, target, positive)
        steps -= 1
        if steps < 0:
            return None
        solution = ahead


def _solved_by(matrix: FloatArray, target: FloatArray, chosen: BoolArray) -> FloatArray:
    """(k,) least squares with the chosen columns (k,), the others' values 0."""
    values = np.zeros(len(chosen))
    values[chosen] = np.linalg.lstsq(matrix[:, chosen], target, rcond=None)[0]
    return values


def least_squares_within(factor: FloatArray, target: FloatArray, conditions: FloatArray) -> FloatArray | None:
    """The x of least ‖R·x − d‖ among those with G·x ≥ 0; None where rounding keeps it from being found.

    R (b, b) is triangular, of full rank. With y = R·x − d this is a least-distance problem, whose dual is one of
    non-negative least squares.
    """
    from scipy.linalg import solve_triangular

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
    weights = nonnegative_least_squares(dual, unit)
    if weights is None:
        return None
    rest = dual @ weights - unit
    if not abs(rest[-1]) > np.finfo(np.float64).eps:
        return None
    return np.asarray(solve_triangular(factor, target - size * rest[:-1] / rest[-1]))
