"""Steps of nonlinear friction: the shapes α and v_s by Gauss-Newton, and the load torque that friction follows.

The exact derivatives ∂τ/∂α and ∂τ/∂v_s are columns of the regression beside the others, so that a step of the shapes is
that of the cost with all linear parameters estimated anew (variable projection; Golub and Pereyra, Inverse Problems 19,
2003).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.ranges import EXPONENT, STRIBECK_VELOCITY
from ident.model.base_parameters import BaseParameters
from ident.model.dynamic_model import DynamicModel
from ident.model.friction_terms import FrictionTerms, LoadTorque
from ident.model.regressor import LoadTorqueKernel
from ident.signals.prepared import Prepared

COEFFICIENT_OF = {"exponent": "viscous", "stribeck_velocity": "stribeck"}
"""Kind of the coefficient that a shape's sensitivity is multiplied with."""

LARGEST_FACTOR = 2.0
"""By which a shape may change in one step."""

ROOT_DISTANCE = 0.02
"""Least distance of α from 0.5, the exponent of the temperature columns, where a motor has those."""

SHORTER = 0.3
"""By which a step is shortened that does not improve the fit."""

MOST_SHORTER_STEPS = 4
"""Lengths of a step that are tried."""

LOAD_TOLERANCE = 1e-3
SHAPE_TOLERANCE = 1e-4
"""Relative changes below which load torque and shapes count as settled."""


Fit = TypeVar("Fit")


def own_column(model: DynamicModel, columns: Sequence[int], kind: str, motor: int) -> int | None:
    """Place among standard `columns` of a motor's own parameter of a kind; None where it is not among them."""
    standard, joint = model.parameters, model.active[motor]
    found = (
        place
        for place, column in enumerate(columns)
        if standard[column].kind == kind and standard[column].joint == joint
    )
    return next(found, None)


def gravity_of(base: BaseParameters, parameters: FloatArray) -> LoadTorque:
    """What the links' parameters among base parameters (b,) say of gravity (AUBO eq. 18)."""
    links = [place for place, kind in enumerate(base.kinds) if kind == "inertial"]
    return LoadTorque(tuple(base.columns[place] for place in links), tuple(parameters[links].tolist()))


def shortened_step(
    terms: FrictionTerms, value: Callable[[str, int], float | None], improved: Callable[[FrictionTerms], Fit | None]
) -> tuple[Fit | None, float]:
    """The first of ever shorter Gauss-Newton steps that improves the fit, and its largest relative change of a shape.

    Args:
        terms: before.
        value: as of `moved_shapes`.
        improved: the fit with other terms; None where it is no better.

    Returns:
        No fit where the change is below `SHAPE_TOLERANCE`, and no fit and 0 where no step improves it.
    """
    for shorter in range(MOST_SHORTER_STEPS):
        moved = moved_shapes(terms, value, SHORTER**shorter)
        change = shape_change(terms, moved)
        if change < SHAPE_TOLERANCE:
            return None, change
        if (fit := improved(moved)) is not None:
            return fit, change
    return None, 0.0


def moved_shapes(terms: FrictionTerms, value: Callable[[str, int], float | None], share: float) -> FrictionTerms:
    """The terms with every free shape changed by a share of its Gauss-Newton step, within its range.

    Args:
        terms: before.
        value: parameter of a kind and a motor by a regression with sensitivities; None where it was not estimated.
        share: 0 to 1.
    """

    def moved(shape: float, free: bool, kind: str, motor: int) -> float:
        slope, coefficient = value(kind, motor), value(COEFFICIENT_OF[kind], motor)
        if not free or slope is None or coefficient is None or coefficient == 0.0:
            return shape
        near = np.clip(shape + share * slope / coefficient, shape / LARGEST_FACTOR, shape * LARGEST_FACTOR)
        return within_range(terms, kind, motor, float(near))

    exponents = zip(terms.exponent, terms.free_exponent, strict=True)
    velocities = zip(terms.stribeck_velocity, terms.free_stribeck_velocity, strict=True)
    return replace(
        terms,
        exponent=tuple(moved(shape, free, "exponent", m) for m, (shape, free) in enumerate(exponents)),
        stribeck_velocity=tuple(
            moved(shape, free, "stribeck_velocity", m) for m, (shape, free) in enumerate(velocities)
        ),
    )


def within_range(terms: FrictionTerms, kind: str, motor: int, value: float) -> float:
    """The allowed value of a motor's shape that is nearest to `value`."""
    allowed = EXPONENT if kind == "exponent" else STRIBECK_VELOCITY
    low, high = allowed.least, allowed.most
    if kind == "exponent" and terms.temperature[motor] != "none":
        # Both columns are √|q̇| at 0.5; no step leads past it.
        low, high = (max(low, 0.5 + ROOT_DISTANCE), high) if terms.exponent[motor] > 0.5 else (low, 0.5 - ROOT_DISTANCE)
    return float(np.clip(value, low, high))


def shifted_shapes(terms: FrictionTerms, changes: Mapping[tuple[str, int], float]) -> FrictionTerms:
    """The terms with shapes changed, by kind and motor, within their ranges."""
    exponent, velocity = list(terms.exponent), list(terms.stribeck_velocity)
    for (kind, motor), change in changes.items():
        values = exponent if kind == "exponent" else velocity
        values[motor] = within_range(terms, kind, motor, values[motor] + change)
    return replace(terms, exponent=tuple(exponent), stribeck_velocity=tuple(velocity))


def braking(terms: FrictionTerms, value: Callable[[str, int], float | None]) -> bool:
    """Whether the friction around an estimated exponent brakes: Fv and Fs are not negative (AUBO eq. 16).

    On a poor motion a flat power law and Coulomb friction of opposite signs fit as well as one of them alone.

    Args:
        terms: with the exponents that are estimated.
        value: parameter of a kind and a motor; None where it was not estimated.
    """
    return all(
        (value(kind, motor) or 0.0) >= 0.0
        for motor, free in enumerate(terms.free_exponent)
        if free
        for kind in ("viscous", "coulomb")
    )


def shape_change(before: FrictionTerms, after: FrictionTerms) -> float:
    """Largest relative change of a shape."""
    old, new = (np.array([*terms.exponent, *terms.stribeck_velocity]) for terms in (before, after))
    return float(np.max(np.abs(new - old) / old))


def load_change(model: DynamicModel, runs: Sequence[Prepared], before: FrictionTerms, after: FrictionTerms) -> float:
    """Largest change of a motor's load torque over the data's largest one of any motor."""
    if before.load_torque is None:
        return float("inf")
    old, new = (LoadTorqueKernel(replace(model, terms=terms)) for terms in (before, after))
    change, size = 0.0, float(np.finfo(np.float64).tiny)
    for run in runs:
        for segment in run.segments:
            position = segment.position[:, :: run.parallel_filter.factor]
            torque = new.torque(position)
            change = max(change, float(np.max(np.abs(torque - old.torque(position)))))
            size = max(size, float(np.max(np.abs(torque))))
    return change / size
