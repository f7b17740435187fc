"""Search a local optimum from one start: a few rounds of nonlinear programming, each with a sharper problem.

Extreme eigenvalues and largest uses have kinks where two of them meet, and an optimum lies on such kinks. So the first
round smooths them strongly, the last one barely.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize

from drivers.core.arrays import FloatArray
from ident.excite.search.problem import DesignProblem

REACHES = (0.5, 0.15)
"""Largest change of a variable in a round, in this order. A family scales variables to the order of 1; a line search
that jumps to 10⁵, or into a collision, does not return."""

OPENING_REACH = 0.3
"""The same of `OPENING`."""
CHECKED_DECREASE = 0.05
"""Decrease of the cost (a logarithm) from which on an iterate is worth a check before its round ends."""
OUTSIDE_ITERATIONS = 5
"""Iterations after which an iterate outside the limits is checked too: shrunk, it may be the best so far."""
_SAMPLES_AT_MAXIMUM = 1000.0
"""Samples that may share a soft maximum: an iterate whose bound exceeds the limit by log of it over the sharpness does
exceed the limit."""


@dataclass(frozen=True)
class Round:
    """How blunt a round's problem is."""

    cost_sharpness: float  # order of the power means of eigenvalues
    limit_sharpness: float  # of the soft maximum of uses
    iterations: int  # at most
    tolerance: float  # change of the cost (a logarithm) at which the round ends


OPENING = Round(4.0, 300.0, 25, 1e-3)
"""A short round with sharp limits: from a feasible motion it soon reaches a better one that nearly keeps them, where
narrow ranges leave a blunt round outside for long."""

ROUNDS = (Round(4.0, 30.0, 100, 1e-4), Round(16.0, 100.0, 100, 1e-4), Round(64.0, 300.0, 100, 1e-4))


@dataclass(frozen=True)
class Callbacks:
    """Callbacks of a solver; either may end it by raising."""

    tick: Callable[[], None]  # before every evaluation
    # with an iterate (size,) of lower cost than those before; returns whether it keeps all limits
    visit: Callable[[FloatArray], bool]


UNWATCHED = Callbacks(lambda: None, lambda variables: False)


def solve(problem: DesignProblem, start: FloatArray, watch: Callbacks = UNWATCHED) -> Iterator[FloatArray]:
    """Step from `start` towards a local optimum: the variables (size,) after every round."""
    variables = start
    for step in ROUNDS:
        variables = _round(problem, variables, step, watch)
        yield variables


def open_search(problem: DesignProblem, feasible: FloatArray, watch: Callbacks = UNWATCHED) -> FloatArray:
    """A better motion near a feasible one; it may exceed the limits a little."""
    return _slsqp(_Evaluations(problem, OPENING, watch), feasible, OPENING, OPENING_REACH)


def tighten(problem: DesignProblem, variables: FloatArray, watch: Callbacks = UNWATCHED) -> FloatArray:
    """Another last round from `variables`, for a problem whose limits were narrowed."""
    return _round(problem, variables, ROUNDS[-1], watch)


def _round(problem: DesignProblem, start: FloatArray, step: Round, watch: Callbacks) -> FloatArray:
    """Result of a round; with a shorter reach where it ends further outside the limits than it began."""
    before = max(problem.allowed, float(problem.use(start).max(initial=0.0)))
    for reach in REACHES:
        minimum = _slsqp(_Evaluations(problem, step, watch), start, step, reach)
        if float(problem.use(minimum).max(initial=0.0)) <= before:
            return minimum
    return start


class _Evaluations:
    """Smooth cost and slacks allowed − smooth use (m,), computed once for each point that a solver evaluates."""

    def __init__(self, problem: DesignProblem, step: Round, watch: Callbacks) -> None:
        self._problem = problem
        self._step = step
        self._watch = watch
        self._lowest = np.inf
        self._iterations = 0
        self._cost_at: FloatArray | None = None
        self._cost: tuple[float, FloatArray] = (np.inf, np.zeros(0))
        self._slack_at: FloatArray | None = None
        self._slack: tuple[FloatArray, FloatArray] = (np.zeros(0), np.zeros((0, 0)))

    def cost(self, variables: FloatArray) -> tuple[float, FloatArray]:
        """Smooth cost and its derivatives (size,)."""
        if self._cost_at is None or not np.array_equal(self._cost_at, variables):
            self._watch.tick()
            self._cost = self._problem.smooth_cost(variables, self._step.cost_sharpness)
            self._cost_at = variables.copy()
        return self._cost

    def slacks(self, variables: FloatArray) -> FloatArray:
        """(m,), negative where a limit is exceeded."""
        return self._slacks(variables)[0]

    def slack_derivatives(self, variables: FloatArray) -> FloatArray:
        """(m, size)."""
        return self._slacks(variables)[1]

    def iterate(self, variables: FloatArray, *state: object) -> None:
        """Pass an iterate on where it may be better than those before: called by solvers after each iteration."""
        cost, _ = self.cost(variables)
        worst = float(self.slacks(variables).min(initial=np.inf))
        overestimate = np.log(_SAMPLES_AT_MAXIMUM) / self._step.limit_sharpness
        self._iterations += 1
        near = worst >= -overestimate or self._iterations % OUTSIDE_ITERATIONS == 0
        if near and cost < self._lowest - CHECKED_DECREASE and self._watch.visit(variables.copy()):
            self._lowest = cost

    def _slacks(self, variables: FloatArray) -> tuple[FloatArray, FloatArray]:
        if self._slack_at is None or not np.array_equal(self._slack_at, variables):
            self._watch.tick()
            uses, rows = self._problem.smooth_use(variables, self._step.limit_sharpness)
            self._slack = self._problem.allowed - uses, -rows
            self._slack_at = variables.copy()
        return self._slack


def _bounds(start: FloatArray, reach: float) -> list[tuple[float, float]]:
    return [(value - reach, value + reach) for value in start]


def _slsqp(evaluations: _Evaluations, start: FloatArray, step: Round, reach: float) -> FloatArray:
    limits: Any = {"type": "ineq", "fun": evaluations.slacks, "jac": evaluations.slack_derivatives}
    options: Any = {"maxiter": step.iterations, "ftol": step.tolerance}
    cost: Any = evaluations.cost
    iterate: Any = evaluations.iterate
    minimum = minimize(
        cost,
        start,
        jac=True,
        method="SLSQP",
        bounds=_bounds(start, reach),
        constraints=[limits],
        options=options,
        callback=iterate,
    )
    return np.asarray(minimum.x) if np.all(np.isfinite(minimum.x)) else start
