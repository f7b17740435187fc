"""Particle swarms with a constant or a random inertia weight (ROCR6 eq. 13-15).

`particle_stability` says whether a particle comes to rest (ROCR6 section 3.4, made computable). With its own best point
p and the best of all s fixed, a particle follows x' = (1 + W − θ)·x − W·x₋ + θ1·p + θ2·s, θ = θ1 + θ2 = c1·r1 + c2·r2:
eq. 17, whose lower right entry must be 1 − θ. The paper asks for ‖C(t)‖ < 1, which no W and θ fulfil at every t; W and
θ are random and independent, so that mean and variance follow linear recursions. Their spectral radii decide: below 1
the particle comes to rest (Poli 2009, IEEE Trans. Evolutionary Computation 13).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from ident.estimators.swarm.minimisation import Search


@dataclass(frozen=True)
class Stability:
    """Growth per generation of a particle whose best points do not change."""

    mean: float  # spectral radius of the mean position's recursion
    variance: float  # of the variance's

    @property
    def remark(self) -> str:
        """Return what follows from it; empty where both settle."""
        if self.mean >= 1.0:
            return f"the mean position grows {self.mean:.3g}-fold per generation; only the clamps bound the particles"
        if self.variance >= 1.0:
            return f"the positions' variance grows {self.variance:.3g}-fold per generation; the swarm does not settle"
        return ""


def particle_stability(weight: InertiaWeight, cognitive: float, social: float) -> Stability:
    """Stability of a particle swarm's settings.

    Args:
        weight: of inertia.
        cognitive: c1.
        social: c2.
    """
    w, ww = weight.mean, weight.mean_square
    theta = 0.5 * (cognitive + social)
    variance = (cognitive**2 + social**2) / 12.0
    drift = 1.0 + w - theta
    mean = np.array([[drift, -w], [1.0, 0.0]])
    # E[l²] and E[l·W] of l = 1 + W − θ.
    square = drift**2 + (ww - w**2) + variance
    product = (1.0 - theta) * w + ww
    moments = np.array([[square, -2.0 * product, ww], [drift, -w, 0.0], [1.0, 0.0, 0.0]])
    return Stability(_radius(mean), _radius(moments))


def _radius(matrix: FloatArray) -> float:
    return float(np.max(np.abs(np.linalg.eigvals(matrix))))


@dataclass(frozen=True)
class ConstantWeight:
    """An inertia weight that is the same always (ROCR6 eq. 13)."""

    value: float = 0.7298  # W

    def draw(self, generator: np.random.Generator, count: int) -> FloatArray:
        """(count, 1) times the value."""
        return np.full((count, 1), self.value)

    @property
    def mean(self) -> float:
        """The value."""
        return self.value

    @property
    def mean_square(self) -> float:
        """Return its square."""
        return self.value**2

    def __str__(self) -> str:
        return f"W = {self.value:g}"


@dataclass(frozen=True)
class RandomWeight:
    """A random inertia weight W = μ + σ·N(0, 1), μ = μ_min + (μ_max − μ_min)·rand(0, 1), per particle and generation.

    ROCR6 eq. 15, which prints a sum where the product belongs. The paper gives no values: these are common ones.

    Raises:
        UsageError: the range is empty or the spread negative.
    """

    # least, most: μ_min and μ_max
    least: float = 0.5
    most: float = 0.8
    spread: float = 0.2  # σ

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


InertiaWeight = ConstantWeight | RandomWeight
"""A distribution of inertia weights."""


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
            raise UsageError(f"{self.particles} particles are too few for a swarm", hint="at least 2")
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
