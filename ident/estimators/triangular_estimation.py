"""An estimate that is no least squares of the torque equations, as the least squares of a triangular system.

What follows an estimate solves reduced systems: with fewer columns, with physical conditions. An estimate θ̂ with the
(approximate) inverse covariance RᵀR is therefore written as the system R·θ = R·θ̂.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.core.arrays import FloatArray
from ident.linear_algebra.triangular import triangular
from ident.regression.least_squares import LeastSquares, residual_deviations, solve_weighted
from ident.regression.observation_matrix import JointFactor, Reduction


@dataclass(frozen=True, eq=False)
class TriangularSystem:
    """A system of all joints' equations, weighted, with its solution.

    Attributes:
        reduction: the whole system stands with the first joint that has rows.
        solution: its least squares, with the joints' weights and residuals.
    """

    reduction: Reduction
    solution: LeastSquares


def triangular_system(
    plain: Reduction,
    system: FloatArray,
    weights: FloatArray,
    active: Sequence[int],
    method: str,
    iterations: int = 1,
) -> TriangularSystem:
    """Solve a system that takes the place of the plain equations.

    Args:
        plain: the torque equations, which the residuals are those of.
        system: (k, b + 1) of base columns and right-hand side, weighted.
        weights: (n,) of the joints' rows in it.
        active: base columns.
        method: name.
        iterations: that led to it.

    Raises:
        IdentificationError: columns that depend on each other.
    """
    first = int(np.flatnonzero(weights > 0)[0])

    def joints(factor: FloatArray) -> tuple[JointFactor, ...]:
        everything = tuple(range(plain.column_count))
        return tuple(
            JointFactor(everything, factor / weights[first] if motor == first else factor[:0], joint.rows)
            for motor, joint in enumerate(plain.joints)
        )

    factor = triangular(system)
    factor[-1] = 0.0
    exact = solve_weighted(replace(plain, joints=joints(factor)), active, weights, method)
    factor[-1, -1] = np.sqrt(np.sum(weights**2 * plain.residual_sums(exact.parameters)))
    reduction = replace(plain, joints=joints(factor))
    solution = solve_weighted(reduction, active, weights, method, iterations)
    deviations = residual_deviations(plain, solution.parameters, len(solution.active))
    return TriangularSystem(reduction, replace(solution, joint_std=deviations))


def restricted_solution(reduction: Reduction, full: LeastSquares, columns: Sequence[int]) -> LeastSquares:
    """The same system solved for fewer base columns."""
    return replace(solve_weighted(reduction, columns, full.weights, full.method), joint_std=full.joint_std)
