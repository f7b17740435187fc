"""Options that the searching methods share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from ident.estimators.estimator import Estimator, Setup
from ident.estimators.method import within
from ident.estimators.search_estimator import SearchEstimator, base_space
from ident.estimators.swarm.minimisation import Budget
from ident.estimators.swarm.particle_stability import InertiaWeight
from ident.estimators.swarm.particle_swarm import ConstantWeight, ParticleSwarm
from ident.estimators.torque_estimator import Solve
from ident.ranges import BOX_SHARE, GENERATIONS, LEARNING_FACTOR, POPULATION, SEARCH_TIME, SEED, WEIGHT


@dataclass(frozen=True)
class SwarmOptions:
    """Options of every particle swarm."""

    particles: Annotated[int, within(POPULATION), Field(description="in the swarm")] = 50
    generations: Annotated[int, within(GENERATIONS), Field(description="after the initial one")] = 200
    c1: Annotated[float, within(LEARNING_FACTOR), Field(description="towards a particle's own best point")] = 1.49618
    c2: Annotated[float, within(LEARNING_FACTOR), Field(description="towards the best point of all")] = 1.49618
    box: Annotated[float, within(BOX_SHARE), Field(description="half of the search range, of |least squares|")] = 0.1
    seconds: Annotated[float | None, within(SEARCH_TIME), Field(description="time limit [s]; none if absent")] = None
    seed: Annotated[int, within(SEED), Field(description="of the random numbers")] = 0

    def __post_init__(self) -> None:
        _ = self.swarm  # refused before any work

    @property
    def inertia_weight(self) -> InertiaWeight:
        """A constant one."""
        return ConstantWeight()

    @property
    def swarm(self) -> ParticleSwarm:
        """The optimiser.

        Raises:
            UsageError: settings that contradict each other.
        """
        return ParticleSwarm(self.particles, self.inertia_weight, self.c1, self.c2)


@dataclass(frozen=True)
class ConstantWeightOptions(SwarmOptions):
    """Options of a particle swarm with a constant inertia weight."""

    weight: Annotated[float, within(WEIGHT), Field(description="of inertia, W")] = ConstantWeight.value

    @property
    def inertia_weight(self) -> InertiaWeight:
        """Inertia weight as chosen."""
        return ConstantWeight(self.weight)


def swarm_estimator(options: SwarmOptions, setup: Setup, solve: Solve) -> Estimator:
    """A particle swarm about the least-squares solution `solve`."""
    budget = Budget(options.generations, options.seconds)
    return SearchEstimator(setup, solve, base_space(options.box, setup), options.swarm, budget, options.seed)
