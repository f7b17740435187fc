"""Weighted least squares, then a particle swarm with a random inertia weight about it (ROCR6)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from ident.estimators.estimator import Estimator, Setup
from ident.estimators.method import Method, within
from ident.estimators.search_options import SwarmOptions, swarm_estimator
from ident.estimators.swarm.particle_swarm import RandomWeight
from ident.ranges import WEIGHT
from ident.regression.least_squares import weighted_least_squares


@dataclass(frozen=True)
class RandomWeightOptions(SwarmOptions):
    """Options of a particle swarm with a random inertia weight."""

    least: Annotated[float, within(WEIGHT), Field(description="smallest mean of the inertia weight, μ_min")] = 0.5
    most: Annotated[float, within(WEIGHT), Field(description="largest mean of the inertia weight, μ_max")] = 0.8
    spread: Annotated[float, within(WEIGHT), Field(description="standard deviation about it, σ")] = 0.2

    @property
    def inertia_weight(self) -> RandomWeight:
        """The random weight."""
        return RandomWeight(self.least, self.most, self.spread)


def _estimator(options: RandomWeightOptions, setup: Setup) -> Estimator:
    return swarm_estimator(options, setup, weighted_least_squares)


METHOD = Method(
    "particle swarm with a random inertia weight about weighted least squares (WLS-RWPSO)",
    "torque",
    RandomWeightOptions,
    _estimator,
)
