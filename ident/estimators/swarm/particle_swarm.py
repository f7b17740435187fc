"""Particle swarms with a constant or a random inertia weight (ROCR6 eq. 13-15)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from ident.estimators.swarm.minimisation import Search
from ident.estimators.swarm.particle_stability import InertiaWeight, Stability, particle_stability


@dataclass(frozen=True)
class ConstantWeight:
    """An inertia weight that is the same always (ROCR6 eq. 13).

    Attributes:
        value: W.
    """

    value: float = 0.7298

    def draw(self, generator: np.random.Generator, count: int) -> FloatArray:
        """(count, 1) times the value."""
        return np.full((count, 1), self.value)

    @property
    def mean(self) -> float:
        """The value."""
        return self.value

    @property
    def mean_square(self) -> float:
        """Its square."""
        return self.value**2

    def __str__(self) -> str:
        return f"W = {self.value:g}"


@dataclass(frozen=True)
class RandomWeight:
    """A random inertia weight W = μ + σ·N(0, 1), μ = μ_min + (μ_max − μ_min)·rand(0, 1), per particle and generation.

    ROCR6 eq. 15, which prints a sum where the product belongs. The paper gives no values: these are common ones.

    Attributes:
        least, most: μ_min and μ_max.
        spread: σ.

    Raises:
        UsageError: the range is empty or the spread negative.
    """

    least: float = 0.5
    most: float = 0.8
    spread: float = 0.2

    def __post_init__(self) -> None:
        if not self.least <= self.most or not self.spread >= 0.0:
            raise UsageError(f"no random weight has μ from {self.least:g} to {self.most:g} and σ {self.spread:g}")

    def draw(self, generator: np.random.Generator, count: int) -> FloatArray:
        """(count, 1) weights."""
        centre = self.least + (self.most - self.least) * generator.random((count, 1))
        return np.asarray(centre + self.spread * generator.standard_normal((count, 1)))

    @property
    def mean(self) -> float:
        """Mean of W."""
        return 0.5 * (self.least + self.most)

    @property
    def mean_square(self) -> float:
        """Mean of W²."""
        return self.mean**2 + (self.most - self.least) ** 2 / 12.0 + self.spread**2

    def __str__(self) -> str:
        return f"W of mean {self.mean:g} and standard deviation {(self.mean_square - self.mean**2) ** 0.5:.2g}"


@dataclass(frozen=True)
class ParticleSwarm:
    """Settings of a particle swarm; the defaults are Clerc and Kennedy's, which are stable.

    Velocities are clamped to a share of the box; a particle that reaches a face of the box stays there, and its
    velocity across it becomes 0.

    Attributes:
        particles: in all.
        weight: of inertia.
        cognitive: c1, towards a particle's own best point.
        social: c2, towards the best point of all.
        fastest: largest velocity per generation, as a share of the box's width; None for no clamp.

    Raises:
        UsageError: fewer than two particles, or a negative number.
    """

    particles: int = 50
    weight: InertiaWeight = ConstantWeight()  # frozen
    cognitive: float = 1.49618
    social: float = 1.49618
    fastest: float | None = 0.5

    def __post_init__(self) -> None:
        if self.particles < 2:
            raise UsageError(f"{self.particles} particles are no swarm", hint="at least 2")
        if not (0.0 <= self.cognitive < np.inf and 0.0 <= self.social < np.inf):
            raise UsageError(f"the learning factors {self.cognitive:g} and {self.social:g} are not both positive")
        if self.fastest is not None and not self.fastest > 0.0:
            raise UsageError(f"the velocity clamp {self.fastest:g} is not positive")

    @property
    def stability(self) -> Stability:
        """Stability of a particle whose best points do not change."""
        return particle_stability(self.weight, self.cognitive, self.social)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Say where the settings are unstable."""
        text = self.stability.remark
        return (f"{self.weight}, c1 = {self.cognitive:g}, c2 = {self.social:g}: {text}",) if text else ()

    def run(self, search: Search) -> None:
        """Move until the budget ends it."""
        box = search.box
        fastest = np.inf if self.fastest is None else self.fastest * box.width
        position = search.initial(self.particles)
        velocity = (search.generator.random(position.shape) - 0.5) * np.minimum(box.width, fastest)
        cost = search.costs(position)
        own, own_cost = position.copy(), cost
        while True:
            search.end_generation()
            best = own[np.argmin(own_cost)]
            first, second = search.generator.random((2, *position.shape))
            velocity = (
                self.weight.draw(search.generator, self.particles) * velocity
                + self.cognitive * first * (own - position)
                + self.social * second * (best - position)
            )
            velocity = np.clip(velocity, -fastest, fastest)
            moved = position + velocity
            position = box.clip(moved)
            velocity[position != moved] = 0.0
            cost = search.costs(position)
            better = cost < own_cost
            own[better] = position[better]
            own_cost = np.where(better, cost, own_cost)
