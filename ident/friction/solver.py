"""The solver of friction that is not linear in its parameters: shapes, and the load torque that friction follows.

The shapes are found by variable projection: Gauss-Newton on the shapes, all linear parameters estimated anew at each of
them, with the exact derivatives by the shapes as columns of the regression (Golub and Pereyra, Inverse Problems 19,
2003). The load torque comes from the gravity parameters of the estimate before (AUBO eq. 18), until it does not
change. What is estimated, and how, is a `FrictionProblem`: the equations of an identification, robust ones, or those of
a single joint.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from drivers.core.errors import IdentificationError
from ident.friction.table import SHAPED, SHAPES, Shape
from ident.friction.terms import FrictionTerms

LARGEST_FACTOR = 2.0
"""Factor by which a shape may change in one step."""

ROOT_DISTANCE = 0.02
"""Least distance of α from 0.5, the exponent of the temperature columns, where a motor has those."""

SHORTER = 0.3
"""Factor that shortens a step which does not improve the fit."""

LOAD_TOLERANCE = 1e-3
SHAPE_TOLERANCE = 1e-4
"""Relative changes below which load torque and shapes count as settled."""

ROUNDS = 20
"""Rounds of Gauss-Newton steps and new load torques."""

SHORTENED_STEPS = 4
"""Lengths of a step that are tried."""

Fit = TypeVar("Fit")

Value = Callable[[str, int], float | None]
"""A motor's own parameter of a kind; None where it was not estimated."""


class FrictionProblem(Protocol[Fit]):
    """Equations whose linear parameters can be estimated for any friction terms."""

    def terms(self, fit: Fit) -> FrictionTerms:
        """Terms of a fit."""
        ...

    def value(self, fit: Fit) -> Value:
        """Parameters of a fit."""
        ...

    def linearised(self, fit: Fit) -> Value:
        """Parameters of a fit with the derivatives by the free shapes beside its columns."""
        ...

    def fitted(self, fit: Fit, terms: FrictionTerms) -> Fit:
        """Another fit, with other shapes."""
        ...

    def no_worse(self, fit: Fit, before: Fit) -> bool:
        """Return whether the misfit of a fit is not larger than that of the fit before."""
        ...

    def reloaded(self, fit: Fit) -> tuple[Callable[[], Fit], float]:
        """What makes the fit with the load torque of its own gravity parameters, and that torque's relative change."""
        ...


@dataclass(frozen=True)
class Settled(Generic[Fit]):
    """End of the solver's iteration."""

    fit: Fit  # the last one
    rounds: int  # number of them
    converged: bool  # whether load torque and shapes did not change any more


def settle(problem: FrictionProblem[Fit], fit: Fit) -> Settled[Fit]:
    """Load torque and shapes in turn until they do not change."""
    for rounds in range(1, ROUNDS + 1):
        of_load = of_shapes = 0.0
        if problem.terms(fit).loaded:
            reload, of_load = problem.reloaded(fit)
            fit = reload()
        if problem.terms(fit).shaped:
            fit, of_shapes = shape_step(problem, fit)
        if of_load < LOAD_TOLERANCE and of_shapes < SHAPE_TOLERANCE:
            return Settled(fit, rounds, True)
    return Settled(fit, ROUNDS, False)


def settle_nested(
    problem: FrictionProblem[Fit], fit: Fit, settled_shapes: Callable[[Fit], Fit], rounds: int
) -> Settled[Fit]:
    """The load torque until it settles, and at every load torque the shapes, for estimates that take a pass each.

    Args:
        problem: the equations.
        fit: to begin with.
        settled_shapes: a fit with its shapes settled.
        rounds: of the load torque, at most.
    """
    fit = settled_shapes(fit)
    for number in range(rounds if problem.terms(fit).loaded else 0):
        reload, change = problem.reloaded(fit)
        if change < LOAD_TOLERANCE:
            return Settled(fit, number, True)
        fit = settled_shapes(reload())
    return Settled(fit, rounds, not problem.terms(fit).loaded)


def shape_step(problem: FrictionProblem[Fit], fit: Fit, lengths: int = SHORTENED_STEPS) -> tuple[Fit, float]:
    """One Gauss-Newton step of the shapes, shortened until a fit is there and no worse; their largest relative change.

    The fit before where the change is below `SHAPE_TOLERANCE`, and with no change where none of the lengths is better.
    """
    terms, value = problem.terms(fit), problem.linearised(fit)
    for length in range(lengths):
        moved = moved_shapes(terms, value, SHORTER**length)
        change = shape_change(terms, moved)
        if change < SHAPE_TOLERANCE:
            return fit, change
        try:
            candidate = problem.fitted(fit, moved)
        except IdentificationError:  # too far: with these shapes columns of the friction are alike
            continue
        if problem.no_worse(candidate, fit) and (_brakes(problem, candidate) or not _brakes(problem, fit)):
            return candidate, change
    return fit, 0.0


def moved_shapes(terms: FrictionTerms, value: Value, share: float) -> FrictionTerms:
    """The terms with every free shape changed by a share, 0 to 1, of its Gauss-Newton step, within its range.

    Args:
        terms: before.
        value: parameters by a regression with the derivatives by the shapes.
        share: of the step.
    """
    moved = terms
    for shape, motor in terms.free_shapes():
        slope, coefficient = value(shape.name, motor), value(SHAPED[shape.name].kind, motor)
        if slope is None or coefficient is None or coefficient == 0.0:
            continue
        before = terms.shape(shape.name, motor)
        near = np.clip(before + share * slope / coefficient, before / LARGEST_FACTOR, before * LARGEST_FACTOR)
        moved = moved.with_shape(shape.name, motor, _within_range(terms, shape, motor, float(near)), free=True)
    return moved


def shifted_shapes(terms: FrictionTerms, changes: Mapping[tuple[str, int], float]) -> FrictionTerms:
    """The terms with free shapes changed, by name and motor, within their ranges.

    A shape is positive: its logarithm changes, by as much as the change is to first order.
    """
    moved = terms
    for (name, motor), change in changes.items():
        before = terms.shape(name, motor)
        value = _within_range(terms, SHAPES[name], motor, float(before * np.exp(np.clip(change / before, -50.0, 50.0))))
        moved = moved.with_shape(name, motor, value, free=True)
    return moved


def _within_range(terms: FrictionTerms, shape: Shape, motor: int, value: float) -> float:
    """The allowed value of a motor's shape that is nearest to `value`."""
    low, high = _allowed(terms, shape, motor, terms.shape(shape.name, motor))
    return float(np.clip(value, low, high))


def _allowed(terms: FrictionTerms, shape: Shape, motor: int, before: float) -> tuple[float, float]:
    """The range of a motor's shape.

    The temperature columns and the power law are both √|q̇| at α = 0.5; a step does not lead past it.
    """
    low, high = shape.allowed.least, shape.allowed.most
    if shape.name != "exponent" or not terms.asks("temperature", motor):
        return low, high
    return (max(low, 0.5 + ROOT_DISTANCE), high) if before > 0.5 else (low, 0.5 - ROOT_DISTANCE)


def shape_change(before: FrictionTerms, after: FrictionTerms) -> float:
    """Largest relative change of a free shape."""
    changes = [
        abs(after.shape(shape.name, motor) - before.shape(shape.name, motor)) / before.shape(shape.name, motor)
        for shape, motor in before.free_shapes()
    ]
    return max(changes, default=0.0)


def _brakes(problem: FrictionProblem[Fit], fit: Fit) -> bool:
    """Return whether the friction around an estimated exponent brakes: Fv and Fs are not negative (AUBO eq. 16).

    On a poor motion a flat power law and Coulomb friction of opposite signs fit as well as one of them alone.
    """
    value = problem.value(fit)
    return all(
        (value(kind, motor) or 0.0) >= 0.0
        for shape, motor in problem.terms(fit).free_shapes()
        if shape.name == "exponent"
        for kind in ("viscous", "coulomb")
    )
