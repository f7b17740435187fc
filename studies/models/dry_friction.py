"""Dry friction of a step: how far its law is violated, and what a call costs (docs/measurements/methods.md).

Random cases of 1 to 8 directions and ranks 1 to 8, good and bad guesses; the violation of the law as a share of
|u_free| + |W|·f of its direction. SciPy's bounded least squares (BVLS) solves some of them beside, on a factor
of W.
Calls as simulations make them: 2 s of an arm at 1 ms, sinusoids with a soft controller. A minute or two.

    python -m studies.models.dry_friction [cases, default 20000]
"""

from __future__ import annotations

import sys
from time import process_time
from typing import Any
from unittest.mock import patch

import numpy as np
from scipy.optimize import lsq_linear

from daq.robot.loader import load_robot
from drivers.core.arrays import FloatArray
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.model.true_parameters import truth_vector
from ident.result.models.simulated_motion import simulated_motion
from ident.simulation import time_stepping
from ident.simulation.dry_friction import dry_friction

CASES = 20_000
REFERENCES = 500
"""Cases of each kind that BVLS solves too."""

KINDS = ("well scaled", "units and sizes 1e-4 to 1e4", "ill-conditioned", "two nearly alike", "limits 1e-4 to 1e4")

Case = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


def case(kind: str, seed: int) -> tuple[Case, FloatArray]:
    """W, u_free, f and a guess; and a factor of W."""
    generator = np.random.default_rng(seed)
    count, rank = (int(size) for size in generator.integers(1, 9, 2))
    directions = generator.normal(size=(count, rank))
    limit = 10.0 ** generator.uniform(-3, 3) * generator.uniform(0.01, 1.0, count)
    if kind == "ill-conditioned":
        directions *= 10.0 ** generator.uniform(-3, 3, rank)
    elif kind == "two nearly alike":
        directions[0] = directions[-1] + 10.0 ** generator.uniform(-16, -4) * directions[0]
    elif kind == "limits 1e-4 to 1e4":
        limit *= 10.0 ** generator.uniform(-4, 4, count)
    elif kind == "units and sizes 1e-4 to 1e4":
        unit = 10.0 ** generator.uniform(-4, 4, count)
        directions, limit = unit[:, None] * directions, limit / unit
    free = directions @ generator.normal(size=rank)
    guesses = (
        generator.uniform(-1.0, 1.0, count) * limit,
        np.zeros(count),
        generator.choice([-1.0, 1.0], count) * limit,
        100.0 * generator.normal(size=count) * limit,
    )
    return (directions @ directions.T, free, limit, guesses[seed % 4]), directions


def violation(given: Case, torque: FloatArray) -> float:
    """Violation of the law of dry friction."""
    matrix, free, limit, _ = given
    velocity = free - matrix @ torque
    forbidden = np.where(np.abs(torque) == limit, np.maximum(0.0, -velocity * np.sign(torque)), np.abs(velocity)) / (
        np.abs(free) + np.abs(matrix) @ limit
    )
    return float(np.max(np.where(np.abs(torque) > limit, np.inf, forbidden)))


def difference(given: Case, torque: FloatArray, other: FloatArray) -> float:
    """Difference of the velocities, which are unique, as a share of |u_free| + |W|·f."""
    matrix, free, limit, _ = given
    return float(np.max(np.abs(matrix @ (torque - other)) / (np.abs(free) + np.abs(matrix) @ limit)))


def random_cases(count: int) -> None:
    """Worst violations, differences and times, a row per kind."""
    print("| | cases | singular | largest violation | largest distance of BVLS | time [µs] | of BVLS [µs] |")
    print("|---|---|---|---|---|---|---|")
    for kind in KINDS:
        worst = reference = spent = spent_beside = 0.0
        singular = 0
        for seed in range(count // len(KINDS)):
            given, factor = case(kind, seed)
            singular += factor.shape[0] > factor.shape[1]
            start = process_time()
            torque = dry_friction(*given)
            spent += process_time() - start
            worst = max(worst, violation(given, torque))
            if seed < REFERENCES:
                start = process_time()
                wanted = np.linalg.lstsq(factor, given[1], rcond=None)[0]
                found = lsq_linear(factor.T, wanted, (-given[2], given[2]), method="bvls", tol=1e-15)
                spent_beside += process_time() - start
                reference = max(reference, difference(given, torque, found.x))
        cases = count // len(KINDS)
        times = f"{1e6 * spent / cases:.0f} | {1e6 * spent_beside / REFERENCES:.0f}"
        print(f"| {kind} | {cases} | {singular} | {worst:.0e} | {reference:.0e} | {times} |")


def simulated_calls(robot: str) -> None:
    """Time of a call along a simulation."""
    robot_file = load_robot(robot)
    model = build_model(robot_file)
    base = base_parameters(model)
    arm = InverseDynamics(model, base, base.projection @ truth_vector(robot_file, model))
    calls: list[Any] = []

    def kept(*given: FloatArray) -> FloatArray:
        calls.append(tuple(values.copy() for values in given))
        return dry_friction(*given)

    still = np.zeros((model.dof, 1))
    gains = 100.0 * np.diagonal(arm.inertia(still)[0])

    def drive(time: float, position: FloatArray, velocity: FloatArray) -> FloatArray:
        wanted = 0.5 * np.sin(time * np.arange(1, model.dof + 1))
        gravity = arm.links(position[:, None], still, still)[:, 0]
        return np.asarray(gravity + gains * (wanted - position) - 0.2 * gains * velocity)

    # In Python, since the compiled steps make their calls themselves.
    slow = patch.object(time_stepping, "compiled_stepping", lambda *given: None)
    with slow, patch.object(time_stepping, "dry_friction", kept):
        simulated_motion(arm, np.zeros(model.dof), np.zeros(model.dof), drive, 2.0, 1e-3)
    times = []
    for _ in range(5):
        start = process_time()
        for given in calls:
            dry_friction(*given)
        times.append(process_time() - start)
    print(f"| {robot} | {len(calls)} | {1e6 * min(times) / len(calls):.0f} |")


def main() -> None:
    """Print both tables."""
    random_cases(int(sys.argv[1]) if len(sys.argv) > 1 else CASES)
    print("\n| arm | calls in 2 s | time [µs] |\n|---|---|---|")
    for robot in ("ur5e", "panda", "sr400"):
        simulated_calls(robot)


if __name__ == "__main__":
    main()
