"""One way to run any optimiser that evaluates populations: budget, Ctrl-C, undefined costs, convergence history."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.errors import IdentificationError, UsageError


@dataclass(frozen=True, eq=False)
class SearchBox:
    """Bounds of d variables.

    Raises:
        UsageError: a range is empty or not finite; names the variable.
    """

    # lower, upper: (d,), each below the other, in the variables' units
    lower: FloatArray
    upper: FloatArray
    names: Sequence[str] = ()  # (d,) of the variables, for messages; numbers where there are none

    def __post_init__(self) -> None:
        if self.lower.ndim != 1 or self.lower.shape != self.upper.shape or not self.lower.size:
            raise ValueError("lower and upper must be vectors of the same length")
        usable = np.isfinite(self.lower) & np.isfinite(self.upper) & (self.lower < self.upper)
        for index in np.flatnonzero(~usable)[:1]:
            name = self.names[index] if self.names else f"variable {index + 1}"
            raise UsageError(
                f"the search range of {name} is empty: {self.lower[index]:g} to {self.upper[index]:g}",
                hint="give a lower bound below the upper one",
            )

    @classmethod
    def around(cls, centre: FloatArray, share: float, names: Sequence[str] = ()) -> SearchBox:
        """Centre ± share·|centre| (d,): ROCR6 takes 10 % of the absolute WLS solution.

        Raises:
            UsageError: the share is not positive, or a centre is 0.
        """
        reach = share * np.abs(centre)
        return cls(centre - reach, centre + reach, names)

    @property
    def width(self) -> FloatArray:
        """(d,) upper minus lower."""
        return self.upper - self.lower

    @property
    def size(self) -> int:
        """Number of variables d."""
        return len(self.lower)

    def draw(self, generator: np.random.Generator, count: int) -> FloatArray:
        """(count, d) evenly distributed points."""
        return self.lower + self.width * generator.random((count, self.size))

    def clip(self, points: FloatArray) -> FloatArray:
        """The points (…, d), moved to the nearest ones of the box."""
        return np.clip(points, self.lower, self.upper)

    def at_bound(self, point: FloatArray, share: float = 1e-3) -> list[int]:
        """Indices of the variables of a point (d,) that lie within a share of the width of a bound."""
        near = np.minimum(point - self.lower, self.upper - point) <= share * self.width
        return [int(index) for index in np.flatnonzero(near)]


Cost = Callable[[FloatArray], FloatArray]
"""Costs (P,) of a population (P, d)."""

Ended = Literal["generations", "time", "interrupted", "optimiser"]
"""What ended a minimisation: its budget, Ctrl-C, or the optimiser's own criterion."""


@dataclass(frozen=True)
class SearchBudget:
    """How long to search.

    Raises:
        UsageError: a number is not positive.
    """

    generations: int  # after the initial population
    seconds: float | None = None  # after which the best so far is the result; None for no limit

    def __post_init__(self) -> None:
        if self.generations < 1:
            raise UsageError(f"a search of {self.generations} generations", hint="at least 1 generation is needed")
        if self.seconds is not None and not self.seconds > 0.0:
            raise UsageError(f"a search of {self.seconds:g} s", hint="give a time limit above 0 s")


@dataclass(frozen=True, eq=False)
class Minimum:
    """The best point that a search found."""

    point: FloatArray  # (d,)
    cost: float  # there
    history: FloatArray  # (G + 1,) best cost after the initial population and after each generation
    evaluations: FloatArray  # (G + 1,) costs that had been evaluated by then
    undefined: int  # costs that were no number; such points were never the best
    ended: Ended  # what ended the search
    remarks: tuple[str, ...] = ()  # what the optimiser says of its settings

    @property
    def generations(self) -> int:
        """Number of completed generations."""
        return max(0, len(self.history) - 1)

    def generations_to(self, cost: float) -> int | None:
        """The first generation whose best cost is not above `cost`; None where none is."""
        reached = np.flatnonzero(self.history <= cost)
        return int(reached[0]) if len(reached) else None


class _BudgetSpentError(Exception):
    def __init__(self, ended: Ended) -> None:
        super().__init__(ended)
        self.ended: Ended = ended


class Search:
    """What an optimiser works with.

    Attributes:
        box: to search.
        generator: of its random numbers.
    """

    def __init__(
        self,
        cost: Cost,
        box: SearchBox,
        budget: SearchBudget,
        generator: np.random.Generator,
        first: FloatArray | None,
        progress: Callable[[float], None],
        clock: Clock,
    ) -> None:
        self.box, self.generator = box, generator
        self.point: FloatArray | None = None
        self.lowest = np.inf
        self.undefined = 0
        self.history: list[float] = []
        self.evaluations: list[int] = []
        self._cost, self._budget, self._progress, self._clock = cost, budget, progress, clock
        self._first = np.empty((0, box.size)) if first is None else box.clip(np.atleast_2d(first))
        self.evaluated = 0
        self._end = np.inf if budget.seconds is None else clock.now() + budget.seconds

    def initial(self, count: int) -> FloatArray:
        """(count, d) points to begin with: those that were given, then random ones."""
        given = self._first[:count]
        return np.concatenate([given, self.box.draw(self.generator, count - len(given))])

    def costs(self, points: FloatArray) -> FloatArray:
        """Costs (P,) of points (P, d) of the box; inf where they are not defined."""
        if self._clock.now() >= self._end and self.point is not None:
            raise _BudgetSpentError("time")
        if not len(points):
            return np.empty(0)
        values = np.array(self._cost(points), dtype=np.float64)
        if values.shape != (len(points),):
            raise ValueError(f"the cost of {len(points)} points has the shape {values.shape}")
        undefined = ~np.isfinite(values)
        values[undefined] = np.inf
        self.undefined += int(undefined.sum())
        self.evaluated += len(points)
        best = int(np.argmin(values))
        if values[best] < self.lowest:
            self.point, self.lowest = points[best].copy(), float(values[best])
        return values

    def end_generation(self) -> None:
        """Called by the optimiser after the initial population and after each generation; may end the search."""
        self.history.append(self.lowest)
        self.evaluations.append(self.evaluated)
        self._progress(self.lowest)
        if len(self.history) > self._budget.generations:
            raise _BudgetSpentError("generations")


class Optimiser(Protocol):
    """A way to minimise a cost, with its settings."""

    @property
    def remarks(self) -> tuple[str, ...]:
        """Return what a user should know of the settings; nothing where they are sound."""

    def run(self, search: Search) -> None:
        """Evaluate generation after generation, until `search` or a criterion of its own ends it."""


def minimise(
    optimiser: Optimiser,
    cost: Cost,
    box: SearchBox,
    budget: SearchBudget,
    seed: int | Sequence[int] = 0,
    first: FloatArray | None = None,
    progress: Callable[[float], None] = lambda lowest: None,
    clock: Clock = SYSTEM_CLOCK,
) -> Minimum:
    """Search a box for the least cost; Ctrl-C and the time limit end it with the best so far.

    Args:
        optimiser: with its settings.
        cost: of a whole population; NaN and infinite ones are survived and counted.
        box: to search.
        budget: how long.
        seed: of all random numbers: the same seed gives the same search.
        first: (k, d) points of the initial population; the others are random.
        progress: called with the least cost after each generation.
        clock: the host's.

    Raises:
        KeyboardInterrupt: Ctrl-C before any cost was evaluated.
        IdentificationError: not one cost was a number.
    """
    search = Search(cost, box, budget, np.random.default_rng(seed), first, progress, clock)
    ended: Ended = "optimiser"
    try:
        optimiser.run(search)
    except _BudgetSpentError as spent:
        ended = spent.ended
    except KeyboardInterrupt:
        if search.point is None:
            raise
        ended = "interrupted"
    if search.point is None:
        raise IdentificationError(
            f"none of {search.undefined} costs is a number", hint="narrow the search box or check the cost"
        )
    if not search.history or search.history[-1] != search.lowest:
        search.history.append(search.lowest)
        search.evaluations.append(search.evaluated)
    return Minimum(
        point=search.point,
        cost=search.lowest,
        history=np.array(search.history),
        evaluations=np.array(search.evaluations, dtype=np.float64),
        undefined=search.undefined,
        ended=ended,
        remarks=optimiser.remarks,
    )
