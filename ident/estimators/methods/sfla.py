"""Shuffled frog leaping over the links' physical parameters (UP6)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from drivers.core.ranges import Range
from ident.estimators.estimator import Estimator, Setup
from ident.estimators.method import Method, within
from ident.estimators.physical_space import physical_space
from ident.estimators.search_estimator import SearchEstimator
from ident.estimators.swarm.frog_leaping import FrogLeaping
from ident.estimators.swarm.minimisation import SearchBudget
from ident.ranges import BOX_SHARE, GENERATIONS, LEARNING_FACTOR, POPULATION, SEARCH_TIME, SEED
from ident.regression.least_squares import weighted_least_squares


@dataclass(frozen=True)
class FrogOptions:
    """Options of shuffled frog leaping; the defaults are UP6 Table 2's."""

    frogs: Annotated[int, within(POPULATION), Field(description="N, in all")] = FrogLeaping.frogs
    memeplexes: Annotated[int, within(POPULATION), Field(description="m, of equal size")] = FrogLeaping.memeplexes
    leaps: Annotated[int, within(GENERATIONS), Field(description="of a memeplex per generation")] = FrogLeaping.leaps
    generations: Annotated[int, within(GENERATIONS), Field(description="G, between shuffles")] = 50
    reach: Annotated[float, within(LEARNING_FACTOR), Field(description="c, length of a leap")] = FrogLeaping.reach
    random: Annotated[Literal["leap", "coordinate"], Field(description="what has a random number of its own")] = (
        FrogLeaping.random
    )
    largest_leap: Annotated[
        float | None,
        within(Range(1e-6, 1e3)),
        Field(description="D_max, longest leap in widths of the box; no limit if absent"),
    ] = FrogLeaping.largest_leap
    box: Annotated[float, within(BOX_SHARE), Field(description="factor of every search range about the prior body")] = (
        1.0
    )
    feasible: Annotated[bool, Field(description="penalise links that cannot exist")] = False
    seconds: Annotated[float | None, within(SEARCH_TIME), Field(description="time limit [s]; none if absent")] = None
    seed: Annotated[int, within(SEED), Field(description="of the random numbers")] = 0

    def __post_init__(self) -> None:
        _ = self.optimiser  # refused before any work

    @property
    def optimiser(self) -> FrogLeaping:
        """Build the optimiser with these settings.

        Raises:
            UsageError: they contradict each other.
        """
        return FrogLeaping(self.frogs, self.memeplexes, self.leaps, self.reach, self.largest_leap, self.random)


def _estimator(options: FrogOptions, setup: Setup) -> Estimator:
    budget = SearchBudget(options.generations, options.seconds)
    space = physical_space(setup, options.feasible, options.box)
    return SearchEstimator(setup, weighted_least_squares, space, options.optimiser, budget, options.seed)


METHOD = Method(
    "shuffled frog leaping over mass, centre of mass, inertia and joint parameters, about the links' prior bodies",
    "torque",
    FrogOptions,
    _estimator,
)
