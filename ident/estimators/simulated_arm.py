"""The motion that an arm with estimated parameters makes in a simulated position loop around the recorded one."""

from __future__ import annotations

import math
from collections.abc import Sequence

from drivers.core.errors import IdentificationError, ModelError
from ident.estimators.estimator import Setup
from ident.estimators.feasible.consistent import found_consistent
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.regression.estimate import estimate_of
from ident.regression.least_squares import LeastSquares
from ident.regression.observability import whole_arm
from ident.regression.observation_matrix import Reduction
from ident.signals.cutoffs import choose_cutoffs
from ident.signals.options import PreprocessChoices
from ident.signals.prepared import Prepared, Segment
from ident.simulation.closed_loop import simulated_segment

SIMULATION_SETTLED = 0.5
"""Largest change of a parameter, over its classical deviation. Smaller ones are noise of the simulation: where a
simulated joint reverses, the sampled sign of its velocity changes a sample earlier or later."""


def loop_bandwidth(run: Prepared) -> float:
    """ω [rad/s] of the position loop: where the positions' low-pass ends by default, twenty times the motion's band."""
    return 2.0 * math.pi * choose_cutoffs(run.cutoffs.band, run.segments[0].rate, PreprocessChoices()).position


def check_whole_arm(setup: Setup, method: str) -> None:
    """Refuse what cannot be simulated.

    Raises:
        IdentificationError: a joint stood still, so that the arm's parameters are not all known.
    """
    if setup.experiment != whole_arm(setup.kernel.model):
        raise IdentificationError(
            f"the method {method} simulates the whole arm, but not all joints moved or not all torques are used",
            hint="record a motion of all joints, or use --method wls",
        )


def simulable_arm(setup: Setup, reduction: Reduction, solution: LeastSquares) -> InverseDynamics:
    """A physically consistent arm near a solution.

    Raises:
        IdentificationError: there is none.
    """
    model = setup.kernel.model
    estimate = estimate_of(reduction, solution, solution.covariance, 1)
    consistent = found_consistent(model, setup.base, estimate, setup.robot_file)
    if consistent is None:
        raise IdentificationError(
            "no physically consistent arm is near the estimate, so that there is none to simulate",
            hint="use --method wls",
        )
    return InverseDynamics(model, setup.base, consistent.base)


def simulated_motions(
    setup: Setup, runs: Sequence[Prepared], reduction: Reduction, solution: LeastSquares, bandwidth: float | None
) -> list[tuple[Segment, ...]]:
    """Segments of each run with the motion of the simulated arm, physically consistent and near the solution.

    Args:
        setup: of the estimator.
        runs: whose motion the arm follows.
        reduction: system that was solved.
        solution: of it.
        bandwidth: ω [rad/s]; `loop_bandwidth` where None.

    Raises:
        IdentificationError: no arm near the solution can be simulated.
    """
    inverse = simulable_arm(setup, reduction, solution)
    try:
        return [
            tuple(
                simulated_segment(inverse, segment, loop_bandwidth(run) if bandwidth is None else bandwidth)
                for segment in run.segments
            )
            for run in runs
        ]
    except ModelError as error:
        raise IdentificationError(
            f"the identified arm cannot be simulated: {error.message}", hint="use --method wls"
        ) from error
