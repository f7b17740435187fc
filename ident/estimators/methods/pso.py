"""Particle swarm about ordinary or weighted least squares, with a constant or a random inertia weight (ROCR6)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from drivers.core.errors import UsageError
from drivers.core.ranges import Range
from ident.estimators.estimator import Estimator, Setup
from ident.estimators.method import Method, within
from ident.estimators.search_estimator import SearchEstimator, base_space
from ident.estimators.swarm.minimisation import SearchBudget
from ident.estimators.swarm.particle_swarm import ConstantWeight, InertiaWeight, ParticleSwarm, RandomWeight
from ident.ranges import BOX_SHARE, GENERATIONS, LEARNING_FACTOR, POPULATION, SEARCH_TIME, SEED
from ident.regression.least_squares import ordinary_least_squares, weighted_least_squares

Weight = Annotated[float | None, within(Range(0.0, 100.0))]


@dataclass(frozen=True)
class SwarmOptions:
    """Options of a particle swarm; of the inertia weight's, those count that belong to `inertia`."""

    about: Annotated[Literal["ols", "wls"], Field(description="least squares at the centre of the search range")] = (
        "wls"
    )
    inertia: Annotated[Literal["constant", "random"], Field(description="inertia weight, constant or random")] = (
        "constant"
    )
    particles: Annotated[int, within(POPULATION), Field(description="in the swarm")] = 50
    generations: Annotated[int, within(GENERATIONS), Field(description="after the initial one")] = 200
    c1: Annotated[float, within(LEARNING_FACTOR), Field(description="towards a particle's own best point")] = 1.49618
    c2: Annotated[float, within(LEARNING_FACTOR), Field(description="towards the best point of all")] = 1.49618
    weight: Annotated[Weight, Field(description="constant weight W; 0.7298 if absent")] = None
    least: Annotated[Weight, Field(description="smallest mean of a random weight, μ_min; 0.5 if absent")] = None
    most: Annotated[Weight, Field(description="largest mean of a random weight, μ_max; 0.8 if absent")] = None
    spread: Annotated[Weight, Field(description="standard deviation about it, σ; 0.2 if absent")] = None
    box: Annotated[float, within(BOX_SHARE), Field(description="half of the search range, of |least squares|")] = 0.1
    seconds: Annotated[float | None, within(SEARCH_TIME), Field(description="time limit [s]; none if absent")] = None
    seed: Annotated[int, within(SEED), Field(description="of the random numbers")] = 0

    def __post_init__(self) -> None:
        _ = self.swarm  # refused before any work

    @property
    def inertia_weight(self) -> InertiaWeight:
        """The weight's distribution.

        Raises:
            UsageError: a setting of the other kind of weight, or an empty range.
        """
        constant = {"value": self.weight}
        random = {"least": self.least, "most": self.most, "spread": self.spread}
        given, other = (constant, random) if self.inertia == "constant" else (random, constant)
        if any(value is not None for value in other.values()):
            raise UsageError(
                f"the {self.inertia} inertia weight has no such setting",
                where="--method pso",
                hint="weight belongs to inertia=constant; least, most and spread to inertia=random",
            )
        settings = {name: value for name, value in given.items() if value is not None}
        return ConstantWeight(**settings) if self.inertia == "constant" else RandomWeight(**settings)

    @property
    def swarm(self) -> ParticleSwarm:
        """The optimiser.

        Raises:
            UsageError: settings that contradict each other.
        """
        return ParticleSwarm(self.particles, self.inertia_weight, self.c1, self.c2)


def _estimator(options: SwarmOptions, setup: Setup) -> Estimator:
    solve = ordinary_least_squares if options.about == "ols" else weighted_least_squares
    budget = SearchBudget(options.generations, options.seconds)
    return SearchEstimator(setup, solve, base_space(options.box, setup), options.swarm, budget, options.seed)


METHOD = Method(
    "particle swarm around least squares, which is its exact optimum (PSO)",
    "torque",
    SwarmOptions,
    _estimator,
    {"ls-pso": "about=ols", "wls-pso": "about=wls", "wls-rwpso": "about=wls:inertia=random"},
)
