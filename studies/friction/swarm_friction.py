"""Nonlinear friction with many minima: swarms against multi-start Gauss-Newton, counted in costs.

`python -m studies.friction.swarm_friction` (about 5 minutes of CPU time). One joint, a Fourier motion of 8 s at 250 Hz,
inertia, viscous and Coulomb friction, offset, and a friction shape; noise of 2 % of the torque. The linear part is
eliminated, so that all search the shapes only, in the same box, with at most 3000 costs (LuGre: 1000, 10 seeds). A
difference quotient of the gradient method counts as a cost. A run has succeeded where its cost is within 0.1 % of the
least that any run found.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.optimize import least_squares

from drivers.core.arrays import FloatArray
from ident.estimators.swarm.frog_leaping import FrogLeaping
from ident.estimators.swarm.minimisation import Optimiser, SearchBox, SearchBudget, minimise
from ident.estimators.swarm.particle_swarm import ParticleSwarm, RandomWeight
from studies.friction.friction_shapes import Columns, ShapeCost, lugre_columns, stribeck_columns
from studies.methods.library_optimisers import CmaEs, DifferentialEvolution

RATE, DURATION = 250.0, 8.0
COSTS, SEEDS = 3000, 20
LUGRE_COSTS, LUGRE_SEEDS = 1000, 10
"""Its friction has to be simulated for every cost."""

CLOSE = 1.001
QUOTIENT = 1e-6
"""Step of a difference quotient, in widths of the box."""

TIME = np.arange(round(RATE * DURATION)) / RATE
OPTIMISERS: dict[str, Optimiser] = {
    "SFLA, Table 2": FrogLeaping(),
    "SFLA, r per coordinate": FrogLeaping(random="coordinate"),
    "PSO, 30 particles": ParticleSwarm(30),
    "RWPSO, 30 particles": ParticleSwarm(30, RandomWeight()),
    "differential evolution, 30": DifferentialEvolution(30),
    "CMA-ES, 10": CmaEs(10),
}

PER_GENERATION = {FrogLeaping: 100, ParticleSwarm: 30, DifferentialEvolution: 30, CmaEs: 10}


def motion(peak: float) -> tuple[FloatArray, FloatArray]:
    """Velocity and acceleration (N,) of a Fourier series with this peak velocity [rad/s]."""
    generator = np.random.default_rng(11)
    harmonics = 2 * np.pi / DURATION * np.arange(1, 6)
    sine, cosine = generator.standard_normal((2, 5))
    angle = np.multiply.outer(TIME, harmonics)
    velocity = np.cos(angle) @ sine + np.sin(angle) @ cosine
    scale = peak / np.abs(velocity).max()
    return scale * velocity, scale * ((-np.sin(angle) * harmonics) @ sine + (np.cos(angle) * harmonics) @ cosine)


def problems() -> dict[str, tuple[ShapeCost, SearchBox]]:
    """Name → cost and box."""
    chosen = {}

    def add(name: str, peak: float, make: Columns, truth: list[float], linear: list[float], box: SearchBox) -> None:
        velocity, acceleration = motion(peak)
        plain = [acceleration, velocity, np.ones_like(TIME)]
        if "LuGre" not in name:
            plain.append(np.sign(velocity))
        fixed = np.column_stack(plain)
        clean = fixed @ np.array([2.0, 4.0, 0.5, 5.0])[: fixed.shape[1]] + make(np.array([truth]))[0] @ linear
        noise = 0.02 * np.std(clean) * np.random.default_rng(3).standard_normal(len(TIME))
        chosen[name] = ShapeCost.of(fixed, clean + noise, make), box

    box = SearchBox(np.array([0.2, 0.01, 0.5]), np.array([1.5, 0.5, 3.0]))
    for name, peak in (("Stribeck and α, 1 rad/s", 1.0), ("Stribeck and α, 0.3 rad/s", 0.3)):
        add(name, peak, stribeck_columns(motion(peak)[0]), [0.6, 0.05, 2.0], [3.0, 4.0], box)
    add(
        "LuGre, 0.5 rad/s",
        0.5,
        lugre_columns(motion(0.5)[0], RATE),
        [200.0, 1.6, 0.05],
        [5.0, 0.01],
        SearchBox(np.array([5.0, 1.0, 0.005]), np.array([5000.0, 4.0, 0.5])),
    )
    return chosen


def multi_start(cost: ShapeCost, box: SearchBox, seed: int, costs: int) -> list[tuple[int, float]]:
    """Costs used and least cost after each Gauss-Newton descent (trust region, SciPy) from random starts."""
    generator = np.random.default_rng(seed)
    used, best, told = 0, np.inf, []
    while used < costs:
        start = (box.draw(generator, 1)[0] - box.lower) / box.width

        def residual(scaled: FloatArray) -> FloatArray:
            nonlocal used
            used += 1
            return cost.residual(box.lower + box.width * scaled)

        def derivative(scaled: FloatArray) -> FloatArray:
            nonlocal used
            used += box.size
            steps = np.where(scaled < 0.5, QUOTIENT, -QUOTIENT) * np.eye(box.size)
            points = box.lower + box.width * np.vstack([scaled, scaled + steps])
            here, *beside = cost.residuals(points)
            return np.stack([(other - here) / steps[k, k] for k, other in enumerate(beside)], axis=1)

        found = least_squares(residual, start, derivative, bounds=(0.0, 1.0), max_nfev=100)
        best = min(best, float(np.sqrt(2.0 * found.cost)))
        told.append((used, best))
    return told


def main() -> None:
    """A table per problem."""
    for name, (cost, box) in problems().items():
        costs, seeds = (LUGRE_COSTS, LUGRE_SEEDS) if "LuGre" in name else (COSTS, SEEDS)
        runs: dict[str, list[list[tuple[int, float]]]] = {"multi-start Gauss-Newton": []}
        for seed in range(seeds):
            runs["multi-start Gauss-Newton"].append(multi_start(cost, box, seed, costs))
        for label, optimiser in OPTIMISERS.items():
            runs[label] = []
            for seed in range(seeds):
                found = minimise(optimiser, cost, box, SearchBudget(costs // PER_GENERATION[type(optimiser)] + 1), seed)
                runs[label].append(
                    [
                        (int(count), float(least))
                        for count, least in zip(found.evaluations, found.history, strict=True)
                        if count <= costs
                    ]
                )
        least = min(value for several in runs.values() for told in several for _, value in told)
        print(f"\n{name}: least cost {least:.4f}; of {seeds} seeds, {costs} costs each")
        print(f"{'':28} {'succeed':>8} {'costs to success, median':>26} {'final cost / least, median, worst':>36}")
        for label, several in runs.items():
            needed = [next((n for n, value in told if value <= CLOSE * least), None) for told in several]
            reached = [n for n in needed if n is not None]
            finals = np.array([told[-1][1] for told in several]) / least
            print(
                f"{label:28} {len(reached):8d} {np.median(reached) if reached else np.nan:26.0f}"
                f" {np.median(finals):25.5f} {finals.max():10.4f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
