"""Linear equations with a symmetric positive definite matrix, as expressions: M = L·D·Lᵀ, unrolled."""

from __future__ import annotations

from collections.abc import Sequence

from ident.export.c_code.expressions import Expression, inverse


def solved(matrix: Sequence[Sequence[Expression]], right: Sequence[Expression]) -> tuple[Expression, ...]:
    """X (n,) of M·x = b; not a number where M is not positive definite."""
    count = len(right)
    pivots: list[Expression] = []
    lower: list[list[Expression]] = []  # of L without its diagonal
    for row in range(count):
        scaled: list[Expression] = []  # of L·D
        for column in range(row):
            entry = matrix[row][column]
            for k in range(column):
                entry = entry - scaled[k] * lower[column][k]
            scaled.append(entry)
        lower.append([entry * pivot for entry, pivot in zip(scaled, pivots, strict=True)])
        left = matrix[row][row]
        for entry, share in zip(scaled, lower[row], strict=True):
            left = left - entry * share
        pivots.append(inverse(left))
    forward: list[Expression] = []
    for row in range(count):
        value = right[row]
        for k in range(row):
            value = value - lower[row][k] * forward[k]
        forward.append(value)
    solution = [value * pivot for value, pivot in zip(forward, pivots, strict=True)]
    for row in range(count - 1, -1, -1):
        for k in range(row + 1, count):
            solution[row] = solution[row] - lower[k][row] * solution[k]
    return tuple(solution)
