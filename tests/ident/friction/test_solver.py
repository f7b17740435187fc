"""The solver of shapes and load torque, on equations of one motor that need no arm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from each import each

from drivers.core.errors import IdentificationError
from ident.friction.solver import Value, settle, settle_nested, shape_step
from ident.friction.table import Operands, signal_of
from ident.friction.terms import FrictionTerms, no_terms

SPEED = np.concatenate([side * np.geomspace(0.01, 2.0, 60) for side in (1.0, -1.0)])


@dataclass(frozen=True)
class Solution:
    """Terms, and the value of each column."""

    terms: FrictionTerms
    values: dict[str, float]
    misfit: float


@dataclass(frozen=True)
class OneMotor:
    """Torques (m,) of a motor with plain friction and further terms."""

    torque: np.ndarray

    def solve(self, terms: FrictionTerms) -> Solution:
        kinds = ["viscous", "coulomb", *terms.kinds[0]]
        kinds += [shape.name for shape, _ in terms.free_shapes()] if terms.sensitivities else []
        columns = np.array([signal(kind, terms.shape_of(kind, 0)) for kind in kinds]).T
        values = np.linalg.lstsq(columns, self.torque, rcond=None)[0]
        residual = self.torque - columns @ values
        return Solution(terms, dict(zip(kinds, values.tolist(), strict=True)), float(residual @ residual))

    def terms(self, fit: Solution) -> FrictionTerms:
        return fit.terms

    def value(self, fit: Solution) -> Value:
        return lambda kind, motor: fit.values.get(kind)

    def linearised(self, fit: Solution) -> Value:
        return self.value(self.solve(replace(fit.terms, sensitivities=True)))

    def fitted(self, fit: Solution, terms: FrictionTerms) -> Solution:
        return self.solve(terms)

    def no_worse(self, fit: Solution, before: Solution) -> bool:
        return fit.misfit <= before.misfit

    def reloaded(self, fit: Solution) -> tuple[Callable[[], Solution], float]:
        raise AssertionError("nothing follows a load")


def signal(kind: str, shape: float) -> np.ndarray:
    return np.asarray(signal_of(kind)(Operands(SPEED, np.sign(SPEED), shape)))


@each("seed", range(5))
def test_shapes_are_found_from_a_distant_start(seed):
    generator = np.random.default_rng(seed)
    alpha, velocity = generator.uniform(0.6, 1.6), generator.uniform(0.05, 0.3)
    torque = 3.0 * signal("coulomb", 1.0) + 2.0 * signal("viscous", alpha) + signal("stribeck", velocity)
    start = no_terms(1).with_kinds(0, ["stribeck"])
    start = start.with_shape("exponent", 0, 1.0, free=True)
    start = start.with_shape("stribeck_velocity", 0, 1.5 * velocity, free=True)
    problem = OneMotor(torque)
    first = problem.solve(start)
    settled = settle(problem, first)
    assert settled.converged
    assert settled.fit.terms.shape("exponent", 0) == pytest.approx(alpha, rel=1e-3)
    assert settled.fit.terms.shape("stribeck_velocity", 0) == pytest.approx(velocity, rel=1e-3)
    step, change = shape_step(problem, first)
    assert step.misfit < first.misfit
    assert change > 0.0


def test_a_step_to_shapes_that_have_no_solution_is_shortened():
    class Refusing(OneMotor):
        def fitted(self, fit: Solution, terms: FrictionTerms) -> Solution:
            if terms.shape("exponent", 0) > 1.2:
                raise IdentificationError("dependent columns")
            return self.solve(terms)

    problem = Refusing(3.0 * signal("coulomb", 1.0) + 2.0 * signal("viscous", 1.4))
    first = problem.solve(no_terms(1).with_shape("exponent", 0, 1.0, free=True))
    step, _ = shape_step(problem, first)
    assert step.misfit < first.misfit
    assert 1.0 < step.terms.shape("exponent", 0) <= 1.2


def test_shapes_that_are_known_stay_as_they_are():
    terms = no_terms(1).with_shape("exponent", 0, 0.8)
    settled = settle(OneMotor(signal("viscous", 1.2)), OneMotor(signal("viscous", 1.2)).solve(terms))
    assert settled.fit.terms == terms
    assert settled.rounds == 1


def test_nested_rounds_end_when_the_load_torque_settles():
    """At every load torque the shapes settle first; a load torque that does not change ends the rounds."""
    changes = iter([1.0, 0.1, 1e-4])

    class Loaded(OneMotor):
        def reloaded(self, fit: Solution) -> tuple[Callable[[], Solution], float]:
            return lambda: replace(fit, misfit=fit.misfit + 1.0), next(changes)

    terms = no_terms(1).with_kinds(0, ["load"])
    fits: list[float] = []

    def settled_shapes(fit: Solution) -> Solution:
        fits.append(fit.misfit)
        return fit

    settled = settle_nested(Loaded(SPEED), Solution(terms, {}, 0.0), settled_shapes, 10)
    assert settled.converged
    assert fits == [0.0, 1.0, 2.0]
