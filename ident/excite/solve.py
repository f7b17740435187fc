"""From one start to a local optimum: a few rounds of nonlinear programming, each with a sharper problem.

Extreme eigenvalues and largest uses have kinks where two of them meet, and an optimum lies on such kinks. So the first
round sees them blunt, the last one nearly as they are.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np

from drivers.errors import UsageError
from drivers.streams import FloatArray
from ident.excite.problem import Problem

Solver = Literal["slsqp", "trust-constr", "ipopt"]


@dataclass(frozen=True)
class Round:
    """How blunt a round's problem is.

    Attributes:
        cost_sharpness: order of the power means of eigenvalues.
        limit_sharpness: of the soft maximum of uses.
        iterations: at most.
        tolerance: change of the cost (a logarithm) at which the round ends.
    """

    cost_sharpness: float
    limit_sharpness: float
    iterations: int
    tolerance: float


REACHES = (3.0, 0.5, 0.15)
"""How far a round may move a variable, tried in this order. A family scales variables to the order of 1; a line search
that leaves for 10⁵, or into a collision, does not come back."""

ROUNDS = (Round(4.0, 30.0, 100, 1e-4), Round(16.0, 100.0, 100, 1e-4), Round(64.0, 300.0, 100, 1e-4))


def solve(problem: Problem, start: FloatArray, solver: Solver) -> Iterator[FloatArray]:
    """From `start` towards a local optimum: the variables (size,) after every round.

    Raises:
        UsageError: the solver is not installed.
    """
    variables = start
    for step in ROUNDS:
        variables = _round(problem, variables, solver, step)
        yield variables


def tighten(problem: Problem, variables: FloatArray, solver: Solver) -> FloatArray:
    """Another last round from `variables`, for a problem whose limits were narrowed."""
    return _round(problem, variables, solver, ROUNDS[-1])


def _round(problem: Problem, start: FloatArray, solver: Solver, step: Round) -> FloatArray:
    """What a round reaches; within a shorter reach where it ends further outside the limits than it began."""
    before = max(problem.allowed, float(problem.use(start).max(initial=0.0)))
    for reach in REACHES:
        minimum = _SOLVERS[solver](problem, start, step, reach)
        if float(problem.use(minimum).max(initial=0.0)) <= before:
            return minimum
    return start


class _Slacks:
    """allowed − smooth use (m,) and its derivatives, computed once for each point that a solver asks about."""

    def __init__(self, problem: Problem, sharpness: float) -> None:
        self._problem = problem
        self._sharpness = sharpness
        self._at: FloatArray | None = None
        self._values = np.zeros(0)
        self._rows = np.zeros((0, 0))

    def values(self, variables: FloatArray) -> FloatArray:
        self._look(variables)
        return self._values

    def derivatives(self, variables: FloatArray) -> FloatArray:
        self._look(variables)
        return self._rows

    def _look(self, variables: FloatArray) -> None:
        if self._at is None or not np.array_equal(self._at, variables):
            uses, rows = self._problem.smooth_use(variables, self._sharpness)
            self._at, self._values, self._rows = variables.copy(), self._problem.allowed - uses, -rows


def _cost(problem: Problem, step: Round, variables: FloatArray) -> tuple[float, FloatArray]:
    return problem.smooth_cost(variables, step.cost_sharpness)


def _bounds(start: FloatArray, reach: float) -> list[tuple[float, float]]:
    return [(value - reach, value + reach) for value in start]


def _slsqp(problem: Problem, start: FloatArray, step: Round, reach: float) -> FloatArray:
    from scipy.optimize import minimize

    slacks = _Slacks(problem, step.limit_sharpness)
    limits: Any = {"type": "ineq", "fun": slacks.values, "jac": slacks.derivatives}
    options: Any = {"maxiter": step.iterations, "ftol": step.tolerance}
    cost: Any = partial(_cost, problem, step)
    minimum = minimize(
        cost, start, jac=True, method="SLSQP", bounds=_bounds(start, reach), constraints=[limits], options=options
    )
    return np.asarray(minimum.x) if np.all(np.isfinite(minimum.x)) else start


def _trust_constr(problem: Problem, start: FloatArray, step: Round, reach: float) -> FloatArray:
    from scipy.optimize import BFGS, NonlinearConstraint, minimize

    slacks = _Slacks(problem, step.limit_sharpness)
    limits: Any = NonlinearConstraint(slacks.values, 0.0, np.inf, jac=slacks.derivatives, hess=BFGS())
    options: Any = {"maxiter": 3 * step.iterations, "gtol": step.tolerance, "xtol": 1e-6}
    cost: Any = partial(_cost, problem, step)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="delta_grad == 0.0")  # where no limit is near, as it should be
        minimum = minimize(
            cost,
            start,
            jac=True,
            hess=BFGS(),
            method="trust-constr",
            bounds=_bounds(start, reach),
            constraints=[limits],
            options=options,
        )
    return np.asarray(minimum.x) if np.all(np.isfinite(minimum.x)) else start


def _ipopt(problem: Problem, start: FloatArray, step: Round, reach: float) -> FloatArray:
    try:
        from cyipopt import minimize_ipopt
    except ImportError as error:
        raise UsageError("cyipopt is not installed", hint="pip install cyipopt, or --solver slsqp") from error
    slacks = _Slacks(problem, step.limit_sharpness)
    minimum = minimize_ipopt(
        partial(_cost, problem, step),
        start,
        jac=True,
        bounds=_bounds(start, reach),
        constraints=[{"type": "ineq", "fun": slacks.values, "jac": slacks.derivatives}],
        tol=step.tolerance,
        options={"max_iter": step.iterations, "print_level": 0, "hessian_approximation": "limited-memory"},
    )
    return np.asarray(minimum.x) if np.all(np.isfinite(minimum.x)) else start


_SOLVERS: dict[Solver, Callable[[Problem, FloatArray, Round, float], FloatArray]] = {
    "slsqp": _slsqp,
    "trust-constr": _trust_constr,
    "ipopt": _ipopt,
}
