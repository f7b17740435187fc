"""Shuffled frog leaping over whole motions (UP6 section 4.1), which needs no derivatives and no smoothing."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from drivers.core.arrays import FloatArray
from ident.estimators.swarm.box import SearchBox
from ident.estimators.swarm.frog_leaping import FrogLeaping
from ident.estimators.swarm.minimisation import SearchBudget, minimise
from ident.excite.search.problem import DesignProblem

FROGS = FrogLeaping(random="coordinate")
"""UP6 Table 2, but each coordinate leaps by a random share of its own: 18 and more variables need it."""

GENERATIONS = 50
"""UP6 Table 2."""

OUTSIDE = 1e3
"""Cost of a motion outside the limits, plus its utilisation: worse than any inside, whose cost is a logarithm."""

WIDER = 1.5
"""The box is so many times wider than the range of random motions."""


def leap(
    problem: DesignProblem,
    feasible: FloatArray,
    seed: Sequence[int],
    offer: Callable[[FloatArray], bool],
    tick: Callable[[], None],
) -> None:
    """Offer better and better motions, from a feasible one (size,) and random ones on.

    Args:
        problem: to solve.
        feasible: a frog to begin with.
        seed: of the random numbers.
        offer: called with each motion that keeps the limits on the grid and costs less than those before.
        tick: called before every evaluation; what it raises ends the search.

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
                values[index] = OUTSIDE + use
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
