"""Error bars of an estimate whose friction has estimated shapes: their uncertainty is in every parameter's.

A small change of α or v_s changes the torque by its sensitivity, a column of the regressor. With these columns beside
the others, the jackknife's covariance is that of all parameters and shapes together, to first order, and so is what
systematic errors add to it (`ident.regression.systematic_errors`): near reversals, a wrong torque moves α and all that
depends on it many times as far as it moves any of them alone.

Shapes can be uncertain by so much that a line no longer describes what depends on them (`with_curvature`). Coulomb,
viscous and temperature terms beside |q̇|^α describe one curve over the velocity, which is known well; how it is shared
out among them follows α, and not linearly: beside √|q̇|, Fv grows as 1/(α − 0.5). Where α is estimated too large, its
derivative there is too small, and a linear error bar of Fv with it. So the friction of each motor is estimated again at
shapes √3 σ to both sides. With weights 1/6 these are the outer points of a three-point Gauss-Hermite quadrature: the
mean square change over the shape's distribution, exact to fifth order. By what it exceeds the linear part the error
bars grow.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import IdentificationError
from ident.estimators.estimator import Estimation, Estimator
from ident.estimators.robust.sensitivities import ShapeColumns, shape_columns, with_shapes
from ident.estimators.torque_estimator import reduce_torques
from ident.friction.solver import shifted_shapes
from ident.friction.table import FRICTION_KINDS, SHAPED
from ident.model.joint_columns import own_column
from ident.model.regressor import RegressorKernel
from ident.regression.jackknife import CorrectedCovariance, FilteredRun, block_jackknife
from ident.regression.least_squares import (
    LinearMethod,
    excited_columns,
    ordinary_least_squares,
    solve_weighted,
    weighted_least_squares,
)
from ident.regression.observation_matrix import Reduction
from ident.signals.prepared import Prepared


@dataclass(frozen=True, eq=False)
class FreeShapes:
    """An estimate with its friction's free shapes beside the parameters."""

    kernel: RegressorKernel  # base columns first (b), then the sensitivities to the shapes
    parameters: FloatArray  # (b + all sensitivities,) the estimate; 0 for sensitivities
    active: tuple[int, ...]  # of these columns, those that were estimated: parameters (a), then shapes (s)
    names: tuple[tuple[str, int], ...] = ()  # kind and motor of the shapes (s,)
    # (s,) of the friction whose shape each is: a sensitivity's parameter over it is the shape's change
    coefficients: tuple[float, ...] = ()
    reduction: Reduction | None = None  # the motors' plain equations of these columns; None where no shape is free

    def split(self, corrected: CorrectedCovariance) -> tuple[CorrectedCovariance, dict[tuple[str, int], float]]:
        """The covariance of the parameters alone, and σ of each shape by kind and motor; inf where its friction is 0.

        Args:
            corrected: of parameters and shapes (a + s).
        """
        count = len(self.active) - len(self.names)
        kept = replace(corrected, covariance=corrected.covariance[:count, :count])
        if self.names:
            of_shapes = corrected.covariance[count:]
            finite = np.isfinite(np.diag(of_shapes[:, count:]))
            shared = of_shapes[finite, :count]
            given = kept.covariance - shared.T @ np.linalg.pinv(of_shapes[finite][:, count:][:, finite]) @ shared
            kept = replace(kept, within=given, shapes=self.names, shape_covariance=of_shapes)
        if corrected.random_std is not None:
            kept = replace(kept, random_std=corrected.random_std[:count])
        variances = np.diag(corrected.covariance)[count:]
        return kept, {
            name: float(np.sqrt(variance)) / abs(coefficient) if coefficient else float("inf")
            for name, variance, coefficient in zip(self.names, variances, self.coefficients, strict=True)
        }


def with_free_shapes(
    estimator: Estimator,
    estimation: Estimation,
    torques: Sequence[int],
    runs: Sequence[FilteredRun],
    everything: Sequence[Prepared],
    counted: Sequence[Prepared],
    corrected: CorrectedCovariance,
) -> tuple[CorrectedCovariance, FreeShapes]:
    """The covariance of a solution together with its friction's shapes.

    Args:
        estimator: of the parameters.
        estimation: what it gave, by OLS, WLS or a robust method; of other methods the shapes count as known. The
            covariance remains where no shape was estimated.
        torques: motors whose torques were used.
        runs: the data.
        everything: the same, not filtered yet.
        counted: the same without equations that the estimate rejected, for the plain equations.
        corrected: its covariance for shapes that are known.
    """
    kernel, solution = estimation.kernel, estimation.solution
    known = FreeShapes(kernel, solution.parameters, tuple(solution.active))
    terms = kernel.model.terms
    whitened = bool(estimation.joint_covariance.size)
    if not terms.shaped or not (whitened or solution.method in get_args(LinearMethod)):
        return corrected, known
    shapes = shape_columns(kernel, torques)
    reduction = reduce_torques(shapes.kernel, counted, torques)
    excited = set(excited_columns(reduction))
    if whitened:
        extended, _ = with_shapes(estimation, torques)
        found, free = estimator.covariance(runs, extended), _free_shapes(estimation, shapes, shapes.columns, reduction)
        every = reduce_torques(shapes.kernel, everything, torques)
        if solution.method == "irls" and set(free.active) <= set(excited_columns(every)):
            # Its shapes are those of all equations, whatever it rejects afterwards.
            of_all = block_jackknife(shapes.kernel, runs, weighted_least_squares(every, free.active)).covariance
            found = replace(found, covariance=_with_shapes_of(of_all, found.covariance, len(solution.active)))
        return found, free
    if not set(solution.active) <= excited:
        return corrected, known
    free = _free_shapes(estimation, shapes, [column for column in shapes.columns if column in excited], reduction)
    solve = ordinary_least_squares if solution.method == "ols" else weighted_least_squares
    covariance = block_jackknife(shapes.kernel, runs, solve(reduction, free.active)).covariance
    return replace(corrected, covariance=covariance), free


def _with_shapes_of(known: FloatArray, covariance: FloatArray, count: int) -> FloatArray:
    """The covariance of `count` parameters and of shapes (s,) that are known as by another one of the same."""
    own = covariance[count:, count:]
    slopes = np.vstack([covariance[:count, count:] @ np.linalg.pinv(own), np.eye(len(own))])
    return np.asarray(covariance + slopes @ (known[count:, count:] - own) @ slopes.T)


def _free_shapes(
    estimation: Estimation, shapes: ShapeColumns, columns: Sequence[int], reduction: Reduction
) -> FreeShapes:
    """The estimate beside these sensitivities (s,) of `shapes`."""
    kernel, solution = estimation.kernel, estimation.solution
    names = [
        (kind, motor)
        for column, kind, motor in zip(shapes.columns, shapes.kinds, shapes.motors, strict=True)
        if column in columns
    ]
    places = [own_column(kernel.model, kernel.columns, SHAPED[kind].kind, motor) for kind, motor in names]
    return FreeShapes(
        kernel=shapes.kernel,
        parameters=np.concatenate([solution.parameters, np.zeros(len(shapes.columns))]),
        active=(*solution.active, *columns),
        names=tuple(names),
        coefficients=tuple(0.0 if place is None else float(solution.parameters[place]) for place in places),
        reduction=reduction,
    )


DISTANCE = np.sqrt(3.0)
"""Distance of the quadrature's outer points from the estimate [σ of the shape]."""

WEIGHT = 1.0 / 6.0
"""Weight of each outer point."""


def with_curvature(
    corrected: CorrectedCovariance,
    shape_std: Mapping[tuple[str, int], float],
    free: FreeShapes,
    kernel: RegressorKernel,
    runs: Sequence[Prepared],
    weights: FloatArray,
) -> CorrectedCovariance:
    """The error bars with what is not linear in the shapes; as they are where no shape is free.

    The shapes of all motors are moved at once, and only the friction of their own motors is looked at.

    Args:
        corrected: of the parameters (a).
        shape_std: σ of the shapes, by kind and motor.
        free: the estimate with its shapes.
        kernel: of the base columns alone.
        runs: the data.
        weights: (n,) of the motors' equations.
    """
    terms, finite = kernel.model.terms, {name: std for name, std in shape_std.items() if np.isfinite(std)}
    if free.reduction is None or not finite:
        return corrected
    count, reduction = len(free.active) - len(free.names), free.reduction
    active = list(free.active[:count])
    torques = [motor for motor, joint in enumerate(reduction.joints) if joint.rows]

    def estimated(distance: float) -> FloatArray:
        moved = shifted_shapes(terms, {name: distance * std for name, std in finite.items()})
        shifted = RegressorKernel(replace(kernel.model, terms=moved), kernel.columns)
        system = reduce_torques(shifted, runs, torques)
        if not set(active) <= set(excited_columns(system)):
            raise IdentificationError("the friction vanishes at this shape")
        return solve_weighted(system, active, weights, "wls", 1).parameters[active]

    try:
        here = solve_weighted(reduction, active, weights, "wls", 1).parameters[active]
        outer = [estimated(distance) - here for distance in (-DISTANCE, DISTANCE)]
        inverse = solve_weighted(reduction, free.active, weights, "wls", 1).inverse
    except IdentificationError:  # at one of these shapes the columns depend on each other
        return corrected
    slopes = inverse[:count, count:] @ np.linalg.inv(inverse[count:, count:])
    linear = slopes @ np.array(
        [finite.get(name, 0.0) * coefficient for name, coefficient in zip(free.names, free.coefficients, strict=True)]
    )
    squares = WEIGHT * (np.square(outer[0]) + np.square(outer[1]))
    standard, joints = kernel.model.parameters, {kernel.model.active[motor] for _, motor in finite}
    own = [standard[kernel.columns[place]] for place in active]
    shaped = np.array([column.kind in FRICTION_KINDS and column.joint in joints for column in own])
    return replace(corrected, curvature=np.where(shaped, np.sqrt(np.maximum(squares - np.square(linear), 0.0)), 0.0))
