"""One start of a search: a feasible motion at once, then better ones, iterate by iterate.

A local optimum is searched in a few rounds of nonlinear programming, each with a sharper problem: extreme eigenvalues
and largest uses have kinks where two of them meet, and an optimum lies on such kinks. So the first round smooths them
strongly, the last one barely.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize

from drivers.core.arrays import FloatArray
from drivers.core.text import percent_text
from ident.estimators.swarm.frog_leaping import FrogLeaping
from ident.estimators.swarm.minimisation import SearchBox, SearchBudget, minimise
from ident.excite.choices import Solver
from ident.excite.search.acceptance import LEAST_SHARE, UTILISATION_TOLERANCE, accepted, dense_use, shrunk_to_fit
from ident.excite.search.poses import NoFeasiblePoseError, feasible_pose
from ident.excite.search.problem import DesignProblem, ErrorBar

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


def later_starts(count: int | None) -> Iterator[int]:
    """Numbers of the starts behind start 0, which belongs to the process that asks; endless where `count` is None."""
    return itertools.count(1) if count is None else iter(range(1, count))


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


FROGS = FrogLeaping(random="coordinate")
"""UP6 Table 2, but each coordinate leaps by a random share of its own: 18 and more variables need it."""

GENERATIONS = 50
"""UP6 Table 2."""

OUTSIDE_COST = 1e3
"""Cost of a motion outside the limits, plus its utilisation: worse than any inside, whose cost is a logarithm."""

WIDER = 1.5
"""The box is so many times wider than the range of random motions."""

DRAWS = 20
"""Random members that a start is chosen from."""
SHARES = (1.0, 0.95, 0.9, 0.8, 0.65, 0.5)
"""Amplitudes at which an iterate outside the limits is tested."""
OPENINGS = 2
"""Short rounds from feasible motions before the long ones."""
_TIGHTENINGS = 5


def leap(
    problem: DesignProblem,
    feasible: FloatArray,
    seed: Sequence[int],
    offer: Callable[[FloatArray], bool],
    tick: Callable[[], None],
) -> None:
    """Offer better and better motions, from a feasible one (size,) and random ones on.

    Raises:
        KeyboardInterrupt: Ctrl-C; what was offered remains.
    """
    generator = np.random.default_rng([*seed, 2])
    frogs = np.array([feasible, *(problem.family.random(generator) for _ in range(FROGS.frogs - 1))])
    middle, half = 0.5 * (frogs.max(axis=0) + frogs.min(axis=0)), 0.5 * np.ptp(frogs, axis=0)
    lowest = problem.cost(feasible)

    def cost(motions: FloatArray) -> FloatArray:
        nonlocal lowest
        values = np.empty(len(motions))
        for index, variables in enumerate(motions):
            tick()
            use = float(problem.use(variables).max(initial=0.0))
            if not use <= problem.allowed:
                values[index] = OUTSIDE_COST + use
                continue
            values[index] = problem.cost(variables)
            if values[index] < lowest and offer(variables.copy()):
                lowest = values[index]
        return values

    box = SearchBox(middle - WIDER * half - 1e-9, middle + WIDER * half + 1e-9)
    minimum = minimise(
        FROGS, cost, box, SearchBudget(GENERATIONS), generator.integers(2**32, size=4).tolist(), first=frogs
    )
    if minimum.ended == "interrupted":
        raise KeyboardInterrupt


@dataclass(frozen=True)
class CandidateMotion:
    """A motion that keeps every limit, reported by a start."""

    start: int  # index of the start
    cost: float  # the criterion, exactly (a logarithm)
    condition: float  # column-normalised condition number of the base regressor
    worst: ErrorBar | None  # expected worst error bar; None where no parameters are known beforehand
    variables: FloatArray  # (size,)


@dataclass(frozen=True)
class Finished:
    """A start went through all its rounds."""

    start: int  # its index


Report = CandidateMotion | Finished


def no_tick() -> None:
    """A start without a time limit."""


def run_start(  # noqa: C901 — the steps, in their order
    problem: DesignProblem,
    start: int,
    begin: FloatArray,
    seed: Sequence[int],
    solver: Solver,
    report: Callable[[Report], None],
    tick: Callable[[], None] = no_tick,
) -> None:
    """Report a feasible motion near `begin` first, then every accepted iterate that is better than those before.

    The seed is of the candidate poses where `begin` does not keep the limits. What `tick` raises ends the start; it is
    called before every evaluation.

    Raises:
        NoFeasiblePoseError: no pose was found that keeps all limits; names the one that excludes them.
    """
    best, best_variables = np.inf, begin
    reported = False

    def keep(variables: FloatArray) -> None:
        nonlocal best, best_variables, reported
        path = problem.path(variables)
        cost = problem.criterion.cost(path)
        # The first one counts whatever it costs: a motion that excites nothing may cost inf.
        if not reported or cost < best:
            best, best_variables, reported = cost, variables, True
            condition = float(np.exp(problem.conditioning.cost(path)))
            worst = None if problem.error_bars is None else problem.error_bars.worst(path)
            report(CandidateMotion(start, cost, condition, worst, variables))

    def offer(variables: FloatArray) -> bool:
        if accepted(problem, variables) is None:
            return False
        keep(variables)
        return True

    def offer_shrunk(variables: FloatArray) -> None:
        fitting = shrunk_to_fit(problem, variables, problem.family.middle(variables), tick)
        if fitting is not None:
            keep(fitting)

    def visit(variables: FloatArray) -> bool:
        middle = problem.family.middle(variables)
        for share in SHARES:
            tick()
            shrunk = problem.family.about(variables, middle, share)
            if float(problem.use(shrunk).max(initial=0.0)) <= problem.allowed and problem.cost(shrunk) < best:
                return offer(shrunk) and share == 1.0
        return False

    feasible = _feasible_near(problem, begin, seed, tick)
    keep(feasible)
    if solver == "sfla":
        leap(problem, feasible, seed, offer, tick)
        report(Finished(start))
        return
    watch = Callbacks(tick, visit)
    for _ in range(OPENINGS):
        offer_shrunk(open_search(problem, best_variables, watch))
    variables = opened = best_variables
    for variables in solve(problem, opened, watch):
        offer_shrunk(variables)
    for narrower in _narrowed(problem, variables, watch):
        offer_shrunk(narrower)
    report(Finished(start))


def random_start(
    problem: DesignProblem, seed: Sequence[int], draws: int = DRAWS, tick: Callable[[], None] = no_tick
) -> FloatArray:
    """The first of `draws` random members that keeps all limits, or the one that passes them least; (size,).

    From deep within a collision a local solver does not escape.
    """
    generator = np.random.default_rng(seed)
    best: tuple[float, FloatArray] | None = None
    for _ in range(draws):
        tick()
        variables = problem.family.random(generator)
        use = float(problem.use(variables).max(initial=0.0))
        if best is None or use < best[0]:
            best = use, variables
        if use <= problem.allowed:
            break
    assert best is not None
    return best[1]


def _feasible_near(
    problem: DesignProblem, begin: FloatArray, seed: Sequence[int], tick: Callable[[], None]
) -> FloatArray:
    """The motion itself where it is accepted; else shrunk, about its own middle or a pose with margin to the limits."""
    if accepted(problem, begin) is not None:
        return begin
    middle = problem.family.middle(begin)
    poses = [middle, feasible_pose(problem, middle, seed, tick).position]
    fitting = [shrunk_to_fit(problem, begin, pose, tick) for pose in poses]
    feasible = [variables for variables in fitting if variables is not None]
    if not feasible:
        least = problem.family.about(begin, poses[1], LEAST_SHARE)
        raise NoFeasiblePoseError(
            "no feasible motion: in a pose that keeps all limits, a motion of a thousandth of the amplitude "
            f"uses {_worst(problem, least)}",
            hint="give a longer --ramp or --period",
        )
    return min(feasible, key=problem.cost)


def _worst(problem: DesignProblem, variables: FloatArray) -> str:
    use = problem.use(variables)
    worst = int(np.argmax(use))
    return f"{percent_text(float(use[worst]), 4)} of the {problem.limits[worst]}"


def _narrowed(problem: DesignProblem, variables: FloatArray, watch: Callbacks) -> Iterator[FloatArray]:
    """Further rounds within narrower limits, until they are kept between the grid's points too."""
    if float(problem.use(variables).max(initial=0.0)) > problem.allowed + UTILISATION_TOLERANCE:
        return
    narrowed = problem
    for _ in range(_TIGHTENINGS):
        worst = dense_use(problem, variables)
        if worst <= 1.0:
            return
        narrowed = replace(narrowed, allowed=narrowed.allowed / worst - 1e-3)
        variables = tighten(narrowed, variables, watch)
        yield variables
