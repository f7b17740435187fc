"""Vectors (3,) of expressions, and their products with numbers and with each other."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.core.arrays import FloatArray
from ident.export.c_code.expressions import Expression, Graph

Vector = tuple[Expression, Expression, Expression]
Matrix = tuple[Vector, Vector, Vector]
"""Rows."""


def constant_vector(graph: Graph, values: Sequence[float] | FloatArray) -> Vector:
    """A vector of three numbers."""
    x, y, z = (graph.constant(float(value)) for value in values)
    return x, y, z


def add(left: Vector, other: Vector) -> Vector:
    """Sum."""
    return left[0] + other[0], left[1] + other[1], left[2] + other[2]


def scale(vector: Sequence[Expression | float] | FloatArray, factor: Expression) -> Vector:
    """Product with a factor."""
    x, y, z = (factor * (entry if isinstance(entry, Expression) else float(entry)) for entry in vector)
    return x, y, z


def cross(left: Vector, other: Vector) -> Vector:
    """Cross product one × other."""
    return (
        left[1] * other[2] - left[2] * other[1],
        left[2] * other[0] - left[0] * other[2],
        left[0] * other[1] - left[1] * other[0],
    )


def dot(left: Vector, other: Vector) -> Expression:
    """Scalar product."""
    return left[0] * other[0] + left[1] * other[1] + left[2] * other[2]


def apply(matrix: Matrix, vector: Vector) -> Vector:
    """Product matrix @ vector."""
    return dot(matrix[0], vector), dot(matrix[1], vector), dot(matrix[2], vector)


def transpose(matrix: Matrix) -> Matrix:
    """Transposed matrix."""
    x, y, z = zip(*matrix, strict=True)
    return x, y, z


def constant_matrix(graph: Graph, values: FloatArray) -> Matrix:
    """A matrix (3, 3) of numbers."""
    x, y, z = (constant_vector(graph, row) for row in values)
    return x, y, z
