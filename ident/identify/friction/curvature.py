"""Error bars of friction whose shapes are uncertain by so much that a line no longer describes what depends on them.

Coulomb, viscous and temperature terms beside |q̇|^α describe one curve over the velocity, which is known well; how it
is shared out among them follows α, and not linearly: beside √|q̇|, Fv grows as 1/(α − 0.5). Where α is estimated too
large, its derivative there is too small, and a linear error bar of Fv with it. So the friction of each motor is
estimated again at shapes √3 σ to both sides. With weights 1/6 these are the outer points of a three-point
Gauss-Hermite quadrature: the mean square change over the shape's distribution, exact to fifth order. By what it exceeds
the linear part the error bars grow.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import IdentificationError
from ident.estimators.torque_estimator import reduce_torques
from ident.friction.solver import shifted_shapes
from ident.friction.table import FRICTION_KINDS
from ident.identify.friction.shapes import FreeShapes
from ident.model.regressor import RegressorKernel
from ident.regression.jackknife import CorrectedCovariance
from ident.regression.least_squares import excited_columns, solve_weighted
from ident.signals.prepared import Prepared

DISTANCE = np.sqrt(3.0)
"""Of the quadrature's outer points from the estimate [σ of the shape]."""

WEIGHT = 1.0 / 6.0
"""Of each of them."""


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
    terms, known = kernel.model.terms, {name: std for name, std in shape_std.items() if np.isfinite(std)}
    if free.reduction is None or not known:
        return corrected
    count, reduction = len(free.active) - len(free.names), free.reduction
    active = list(free.active[:count])
    torques = [motor for motor, joint in enumerate(reduction.joints) if joint.rows]

    def estimated(distance: float) -> FloatArray:
        moved = shifted_shapes(terms, {name: distance * std for name, std in known.items()})
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
        [known.get(name, 0.0) * coefficient for name, coefficient in zip(free.names, free.coefficients, strict=True)]
    )
    squares = WEIGHT * (np.square(outer[0]) + np.square(outer[1]))
    standard, joints = kernel.model.parameters, {kernel.model.active[motor] for _, motor in known}
    own = [standard[kernel.columns[place]] for place in active]
    shaped = np.array([one.kind in FRICTION_KINDS and one.joint in joints for one in own])
    return replace(corrected, curvature=np.where(shaped, np.sqrt(np.maximum(squares - np.square(linear), 0.0)), 0.0))
