"""Shuffled frog leaping (SFLA; Eusuff and Lansey 2003), as in the UP6 paper, section 3."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from drivers.core.ranges import Range
from ident.estimators.method import within
from ident.estimators.swarm.minimisation import Search
from ident.ranges import GENERATIONS, LEARNING_FACTOR, POPULATION


@dataclass(frozen=True)
class FrogLeaping:
    """Settings of SFLA; the defaults are those of UP6 Table 2.

    A generation sorts all frogs by cost, deals them out to the memeplexes, lets each memeplex leap `leaps` times, and
    shuffles them. A leap moves the memeplex's worst frog by D = r·c·(X_b − X_w) (eq. 6) towards its best one; where
    that is no improvement, towards the best of all; where that is none either, to a random place of the box. The
    memeplexes are independent within a generation, so that they leap at once.

    Raises:
        UsageError: a memeplex of fewer than two frogs, a remainder, or a reach that is not positive.
    """

    frogs: Annotated[int, within(POPULATION), Field(description="N, in all")] = 50
    memeplexes: Annotated[int, within(POPULATION), Field(description="m, of equal size")] = 10
    leaps: Annotated[int, within(GENERATIONS), Field(description="of a memeplex per generation")] = 10
    reach: Annotated[float, within(LEARNING_FACTOR), Field(description="c, length of a leap")] = 2.0
    # One number keeps a frog on the line between two others.
    random: Annotated[Literal["leap", "coordinate"], Field(description="what gets its own random number")] = "leap"
    # As a length in widths of the box, since the variables have different units.
    largest_leap: Annotated[
        float | None,
        within(Range(1e-6, 1e3)),
        Field(description="D_max, longest leap in widths of the box; no limit if absent"),
    ] = None

    def __post_init__(self) -> None:
        if self.frogs < self.memeplexes:
            raise UsageError(f"{self.memeplexes} memeplexes are more than {self.frogs} frogs")
        if self.frogs % self.memeplexes:
            raise UsageError(f"{self.frogs} frogs do not divide into {self.memeplexes} memeplexes of equal size")
        if self.frogs < 2 * self.memeplexes:
            raise UsageError(
                f"{self.frogs} frogs in {self.memeplexes} memeplexes leave one each, without another to leap towards",
                hint="at least 2 frogs per memeplex",
            )
        if not self.reach > 0.0:
            raise UsageError(f"reach {self.reach:g} is not positive", hint="between 1 and 2")

    @property
    def remarks(self) -> tuple[str, ...]:
        """None."""
        return ()

    def run(self, search: Search) -> None:
        """Leap until the budget ends it."""
        frogs = search.initial(self.frogs)
        costs = search.costs(frogs)
        shape = (self.memeplexes, self.frogs // self.memeplexes)
        while True:
            search.end_generation()
            # Frog k of the sorted ones goes to memeplex k mod m.
            dealt = np.argsort(costs, kind="stable").reshape(shape[1], shape[0]).T
            best_of_all = frogs[dealt[0, 0]].copy()
            members, member_costs = frogs[dealt], costs[dealt]
            for _ in range(self.leaps):
                self._leap(search, members, member_costs, best_of_all)
            frogs, costs = members.reshape(frogs.shape), member_costs.reshape(costs.shape)

    def _leap(self, search: Search, members: FloatArray, costs: FloatArray, best_of_all: FloatArray) -> None:
        """Replace the worst frog of every memeplex; members (m, n, d) and costs (m, n) are changed in place."""
        every = np.arange(len(members))
        worst, best = costs.argmax(axis=1), costs.argmin(axis=1)
        left = every
        for target in (members[every, best], np.broadcast_to(best_of_all, (len(every), search.box.size))):
            landed = self._landing(search, members[left, worst[left]], target[left])
            values = search.costs(landed)
            better = values < costs[left, worst[left]]
            moved = left[better]
            members[moved, worst[moved]], costs[moved, worst[moved]] = landed[better], values[better]
            left = left[~better]
        members[left, worst[left]] = search.box.draw(search.generator, len(left))
        costs[left, worst[left]] = search.costs(members[left, worst[left]])

    def _landing(self, search: Search, start: FloatArray, target: FloatArray) -> FloatArray:
        """Return where frogs (k, d) land that leap from `start` towards `target`."""
        numbers = 1 if self.random == "leap" else search.box.size
        leap = search.generator.random((len(start), numbers)) * self.reach * (target - start)
        if self.largest_leap is not None:
            lengths = np.linalg.norm(leap / search.box.width, axis=1, keepdims=True)
            leap *= np.minimum(1.0, self.largest_leap / np.maximum(lengths, np.finfo(float).tiny))
        return search.box.clip(start + leap)
