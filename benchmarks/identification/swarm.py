"""Swarms on a quadratic cost: on the triangular factor against all rows, and whole searches against peers."""

from __future__ import annotations

import contextlib
import logging
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.agreement import check
from benchmarks.arm import arm
from benchmarks.timing import medians
from drivers.core.arrays import FloatArray
from ident.estimators.swarm.minimisation import SearchBox, SearchBudget, minimise
from ident.estimators.swarm.particle_swarm import ParticleSwarm
from ident.estimators.swarm.physical import QuadraticCost
from ident.linear_algebra.triangular import triangular
from ident.model.base_parameters import base_parameters, random_states
from ident.model.regressor import regressor

COMPARED = """\
swarm_cost_vs_rows: ‖W·x − τ‖ of 200 particles, particle by particle on all rows of 20,000 samples (120,000 rows), over
  the whole population on the triangular factor. swarm_cost_us: that, per particle. swarm_cost_vs_rows_at_once: the
  population in one product on all rows, over ours.
swarm_search_vs_pymoo, swarm_search_vs_pyswarms: a particle swarm of 50 over 100 generations on the factor by
  pymoo.algorithms.soo.nonconvex.pso.PSO (not adaptive) and pyswarms.single.GlobalBestPSO, over ours; all vectorised,
  with the same cost function and box."""

PARTICLES, GENERATIONS, POPULATION = 50, 100, 200


def problem(samples: int) -> tuple[FloatArray, FloatArray, QuadraticCost, SearchBox]:
    """All rows, their torques, the cost on their factor, and a box about the truth."""
    model = arm()
    base = base_parameters(model)
    rows = regressor(model, *random_states(model, samples, seed=1), base.columns)
    matrix = np.ascontiguousarray(np.concatenate([joint.T for joint in rows]))
    generator = np.random.default_rng(1)
    truth = generator.uniform(0.5, 2.0, base.count)
    torque = matrix @ truth + generator.standard_normal(len(matrix))
    factor = triangular(np.column_stack([matrix, torque]))
    cost = QuadraticCost(factor[:-1, :-1], factor[:-1, -1], float(factor[-1, -1] ** 2))
    return matrix, torque, cost, SearchBox.around(truth, 0.1)


def run_rows(samples: int = 20_000, rounds: int = 5) -> dict[str, float]:
    """Compare the cost on the factor with that on all rows.

    Raises:
        DisagreementError: the costs differ.
    """
    matrix, torque, cost, box = problem(samples)
    points = box.draw(np.random.default_rng(2), POPULATION)
    few = points[:5]
    check("cost on the factor against all rows", cost(few), on_rows(matrix, torque, few), 1e-9)
    times = medians(
        {
            "factor": lambda: [cost(points) for _ in range(50)],
            "rows": lambda: on_rows(matrix, torque, few),
            "at once": lambda: np.linalg.norm(matrix @ points.T - torque[:, None], axis=0),
        },
        rounds,
    )
    each = times["factor"] / (50 * POPULATION)
    return {
        "swarm_cost_vs_rows": times["rows"] / 5 / each,
        "swarm_cost_vs_rows_at_once": times["at once"] / POPULATION / each,
        "swarm_cost_us": 1e6 * each,
    }


def run_peers(rounds: int = 5) -> dict[str, float]:
    """Whole searches against pymoo and pyswarms."""
    _, _, cost, box = problem(1000)
    searches = medians(
        {
            "ours": lambda: minimise(ParticleSwarm(PARTICLES), cost, box, SearchBudget(GENERATIONS)),
            "pymoo": lambda: by_pymoo(cost, box),
            "pyswarms": lambda: by_pyswarms(cost, box),
        },
        rounds,
    )
    return {
        "swarm_search_vs_pymoo": searches["pymoo"] / searches["ours"],
        "swarm_search_vs_pyswarms": searches["pyswarms"] / searches["ours"],
        "swarm_search_ms": 1e3 * searches["ours"],
    }


def on_rows(matrix: FloatArray, torque: FloatArray, points: FloatArray) -> FloatArray:
    """Particle by particle."""
    return np.array([np.linalg.norm(matrix @ point - torque) for point in points])


def by_pymoo(cost: QuadraticCost, box: SearchBox) -> float:
    """The least cost."""
    from pymoo.algorithms.soo.nonconvex.pso import PSO
    from pymoo.core.problem import Problem
    from pymoo.optimize import minimize

    class Quadratic(Problem):  # type: ignore[misc]
        def __init__(self) -> None:
            super().__init__(n_var=box.size, n_obj=1, xl=box.lower, xu=box.upper)

        def _evaluate(self, points: FloatArray, out: dict[str, FloatArray], *args: object, **more: object) -> None:
            out["F"] = cost(points)[:, None]

    algorithm = PSO(pop_size=PARTICLES, adaptive=False, pertube_best=False)
    return float(minimize(Quadratic(), algorithm, ("n_gen", GENERATIONS + 1), seed=1, verbose=False).F[0])


def by_pyswarms(cost: QuadraticCost, box: SearchBox) -> float:
    """The least cost."""
    # It writes a log file into the working directory.
    with TemporaryDirectory() as folder, contextlib.chdir(folder):
        from pyswarms.single import GlobalBestPSO

        logging.getLogger("pyswarms").setLevel(logging.ERROR)
        options = {"c1": 1.49618, "c2": 1.49618, "w": 0.7298}
        swarm = GlobalBestPSO(PARTICLES, box.size, options, bounds=(box.lower, box.upper))
        return float(swarm.optimize(cost, GENERATIONS + 1, verbose=False)[0])
