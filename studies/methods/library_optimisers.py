"""What a user would take instead of a swarm: SciPy's differential evolution and CMA-ES, behind the same interface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from drivers.core.errors import UsageError
from ident.estimators.swarm.minimisation import Search


@dataclass(frozen=True)
class DifferentialEvolution:
    """SciPy's differential evolution (best1bin, dithered), evaluated a population at a time.

    Attributes:
        population: of points; at least 5.

    Raises:
        UsageError: fewer.
    """

    population: int = 50

    def __post_init__(self) -> None:
        if self.population < 5:
            raise UsageError(f"differential evolution needs at least 5 points, not {self.population}")

    @property
    def remarks(self) -> tuple[str, ...]:
        """None."""
        return ()

    def run(self, search: Search) -> None:
        """Evolve until the budget ends it, or all points are as good as one."""
        from scipy.optimize import Bounds, differential_evolution

        def end_generation(intermediate_result: Any) -> None:
            search.end_generation()

        started = False

        def cost(points: Any) -> Any:
            nonlocal started
            # SciPy transposes: (d, P).
            values = search.costs(np.ascontiguousarray(points.T))
            if not started:
                started = True
                search.end_generation()
            return values

        differential_evolution(
            cost,
            Bounds(search.box.lower, search.box.upper),
            init=search.initial(self.population),
            maxiter=10**9,
            tol=1e-9,
            polish=False,
            vectorized=True,
            updating="deferred",
            callback=end_generation,
            rng=search.generator,
        )


@dataclass(frozen=True)
class CmaEs:
    """Covariance matrix adaptation (Hansen's `cma`), in units of the box's width.

    Attributes:
        population: of points; at least 4.
        step: initial standard deviation, as a share of the width.

    Raises:
        UsageError: a number is too small.
    """

    population: int = 50
    step: float = 0.3

    def __post_init__(self) -> None:
        if self.population < 4 or not self.step > 0.0:
            raise UsageError(f"CMA-ES needs at least 4 points and a step above 0, not {self.population}, {self.step:g}")

    @property
    def remarks(self) -> tuple[str, ...]:
        """None."""
        return ()

    def run(self, search: Search) -> None:
        """Evolve until the budget or the library's own criteria end it.

        Raises:
            UsageError: the library is not installed.
        """
        try:
            import cma
        except ImportError as error:
            raise UsageError("cma is not installed", hint="pip install 'dynid[dev]'") from error
        box = search.box
        centre = (search.initial(1)[0] - box.lower) / box.width
        # 0 would mean the clock to the library.
        seed = int(search.generator.integers(1, 2**31))
        strategy = cma.CMAEvolutionStrategy(
            centre,
            self.step,
            {"popsize": self.population, "bounds": [0.0, 1.0], "seed": seed, "verbose": -9, "maxiter": 10**9},
        )
        search.costs(search.box.lower + search.box.width * centre[None, :])
        search.end_generation()
        while not strategy.stop():
            points = np.array(strategy.ask())
            values = search.costs(box.clip(box.lower + box.width * points))
            strategy.tell(list(points), values.tolist())
            search.end_generation()
