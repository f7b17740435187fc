"""Excitation of a UR10 as in the literature: five harmonics, 10 s, 36 inertial base columns, no friction.

`python -m benchmarks.identification.excitation` also measures what multi-start reaches in 10 s and
in 60 s on all cores.
"""

from __future__ import annotations

import json
import multiprocessing
import statistics
import time
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from benchmarks.agreement import check
from benchmarks.peers import PinocchioLoop
from daq.robot.loader import RobotFile, load_robot
from drivers.core.arrays import FloatArray
from ident.excite.choices import DesignChoices
from ident.excite.criteria import Criterion, RegressorCriterion
from ident.excite.design import build_problem, design
from ident.excite.path import JointPath
from ident.excite.prior import PriorKnowledge
from ident.excite.search.problem import DesignProblem
from ident.excite.search.search import SearchChoices
from ident.excite.search.start import ROUNDS, solve
from ident.model.dynamic_model import build_model
from ident.model.dynamics.pinocchio_model import PINOCCHIO_ORDER
from ident.model.parameters import INERTIAL

TARGET = 12.0
"""The condition number whose time is taken."""
SAMPLES = 200
PEER_LIMIT = 60.0
"""After this long [s] a peer's start counts as having taken so long."""
CHOICES = DesignChoices(criterion="plain-condition", harmonics=5, period=10.0, margin=0.01, self_collision=False)

COMPARED = """\
excitation_time_to_cond12_vs_slsqp_pin: wall time in one process until a motion within all limits on 200 samples has a
  condition number of 12 or less; median over 5 random starts, the same for both. UR10, 5 harmonics, 10 s, |q| ≤ π,
  |q̈| ≤ 10 rad/s², 66 variables. Peer: SciPy's SLSQP, finite differences over a loop of Pinocchio's
  computeJointTorqueRegressor and numpy's cond, with the very same limits and their exact derivatives."""


def peers_arm() -> RobotFile:
    """The built-in UR10 with the limits of the literature, without friction and motor inertia."""
    file = load_robot("ur10")
    joints = tuple(
        limits.model_copy(update={"position": (-np.pi, np.pi), "acceleration": 10.0}) for limits in file.robot.joints
    )
    drives = tuple(drive.model_copy(update={"inertia": False}) for drive in file.robot.drives)
    friction = file.robot.friction.model_copy(update={"model": "none", "offset": False})
    robot = file.robot.model_copy(update={"joints": joints, "drives": drives, "friction": friction})
    return file.model_copy(update={"robot": robot})


def no_prior() -> PriorKnowledge:
    """Nothing known of the arm, so no torque limits."""
    return PriorKnowledge(parameters=None, noise=np.ones(6), source="none", rate=500.0)


def make_problem() -> DesignProblem:
    """Ours, on a grid of 200 samples."""
    problem = build_problem(peers_arm(), no_prior(), CHOICES)
    time_grid = np.linspace(0.0, CHOICES.period, SAMPLES, endpoint=False)
    return replace(problem, time=time_grid, allowed=0.99)


class PeerCost:
    """The condition number from a loop over Pinocchio."""

    def __init__(self, problem: DesignProblem) -> None:
        model = build_model(peers_arm())
        order = [10 * link + PINOCCHIO_ORDER.index(symbol) for link in range(model.dof) for symbol in INERTIAL]
        self._loop = PinocchioLoop(model)
        assert isinstance(problem.criterion, RegressorCriterion)
        self._columns = [order[column] for column in problem.criterion.columns]
        self._problem = problem
        self._out = np.empty((SAMPLES, model.dof, len(self._columns)))

    def __call__(self, variables: FloatArray) -> float:
        path = self._problem.path(variables)
        motion = tuple(np.ascontiguousarray(a.T) for a in (path.position, path.velocity, path.acceleration))
        self._loop.fill_columns(motion, self._columns, self._out)  # type: ignore[arg-type]
        return float(np.linalg.cond(self._out.reshape(-1, len(self._columns))))


class _ReachedError(Exception):
    """The target was reached."""


class _Watch:
    """A criterion that ends the search where the target is reached within the limits."""

    def __init__(self, inner: Criterion, problem: DesignProblem) -> None:
        self._inner = inner
        self._constraints = problem.constraints

    def cost(self, path: JointPath) -> float:
        return self._inner.cost(path)

    def smooth_cost(self, path: JointPath, sharpness: float) -> tuple[float, FloatArray]:
        inside = all(constraint.use(path).max() <= 1.0 for constraint in self._constraints)
        if inside and np.exp(self._inner.cost(path)) <= TARGET:
            raise _ReachedError
        return self._inner.smooth_cost(path, sharpness)


def our_time(problem: DesignProblem, start: FloatArray) -> float:
    """Seconds [s] from the start to the target; inf where it was not reached."""
    watched = replace(problem, criterion=_Watch(problem.criterion, problem))
    since = time.perf_counter()
    try:
        for _ in solve(watched, start):
            pass
    except _ReachedError:
        return time.perf_counter() - since
    return float("inf")


def peer_time(problem: DesignProblem, start: FloatArray, limit: float = PEER_LIMIT) -> float:
    """The same for the peer; `limit` where it takes longer or ends elsewhere."""
    since = time.perf_counter()
    try:
        peer_solve(problem, start, since + limit, stop=TARGET)
    except _ReachedError:
        return min(time.perf_counter() - since, limit)
    return limit


def peer_solve(problem: DesignProblem, start: FloatArray, deadline: float, stop: float) -> float:
    """SLSQP with finite differences from one start: the least condition number within the limits at an iterate."""
    from scipy.optimize import minimize

    cost = PeerCost(problem)
    sharpness = ROUNDS[-1].limit_sharpness
    best = float("inf")

    def look(variables: FloatArray) -> None:
        nonlocal best
        if problem.use(variables).max() <= 1.0:
            best = min(best, cost(variables))
        if best <= stop:
            raise _ReachedError

    def timed(variables: FloatArray) -> float:
        if time.perf_counter() > deadline:
            raise TimeoutError
        return cost(variables)

    limits: Any = {
        "type": "ineq",
        "fun": lambda x: problem.allowed - problem.smooth_use(x, sharpness)[0],
        "jac": lambda x: -problem.smooth_use(x, sharpness)[1],
    }
    run: Any = minimize
    with suppress(TimeoutError):
        run(timed, start, method="SLSQP", constraints=[limits], callback=look, options={"maxiter": 300})
    return best


def run(seeds: int = 5) -> dict[str, float]:
    """Times to the target, both sides from the same starts.

    Raises:
        DisagreementError: the two sides do not compute the same condition number.
    """
    problem = make_problem()
    ours, theirs = [], []
    for seed in range(seeds):
        start = problem.family.random(np.random.default_rng(seed))
        both = np.array([np.exp(problem.cost(start))]), np.array([PeerCost(problem)(start)])
        check("condition number of a random start", *both, 1e-6 * float(both[0][0]))
        ours.append(our_time(problem, start))
        theirs.append(peer_time(problem, start))
    return {
        "excitation_time_to_cond12_seconds": statistics.median(ours),
        "excitation_time_to_cond12_vs_slsqp_pin": statistics.median(theirs) / statistics.median(ours),
    }


def reached(seconds: float, seed: int) -> tuple[float, float]:
    """Condition number and largest use of a limit on the dense grid, after so long [s] on all cores."""
    found = design(peers_arm(), no_prior(), CHOICES, SearchChoices(seed=seed, starts=None, time=seconds))
    return found.cost, float(found.use.max())


def peer_reached(seconds: float, seed: int) -> float:
    """The peer's best condition number after so long [s], multi-start on all cores."""
    count = multiprocessing.cpu_count()
    with multiprocessing.get_context("spawn").Pool(count) as pool:
        return min(pool.map(partial(_peer_starts, seconds, seed, count), range(count)))


def _peer_starts(seconds: float, seed: int, count: int, worker: int) -> float:
    deadline = time.perf_counter() + seconds
    problem = make_problem()
    best, start = float("inf"), worker
    while time.perf_counter() < deadline:
        begin = problem.family.random(np.random.default_rng([seed, start]))
        best = min(best, peer_solve(problem, begin, deadline, stop=0.0))
        start += count
    return best


def main() -> None:
    """Everything, as JSON."""
    results: dict[str, Any] = run()
    for seconds in (10.0, 60.0):
        ours = [reached(seconds, seed) for seed in range(5)]
        theirs = [peer_reached(seconds, seed) for seed in range(5)]
        results[f"after {seconds:.0f} s"] = {
            "ours, median": statistics.median(cost for cost, _ in ours),
            "ours": [round(cost, 3) for cost, _ in ours],
            "largest use on the dense grid": max(use for _, use in ours),
            "peer, median": statistics.median(theirs),
            "peer": [round(cost, 3) for cost in theirs],
        }
    print(json.dumps(results, indent=2))


if __name__ == "__main__":
    main()
