"""Direct and inverse dynamic identification (Gautier, Janot and Vandanjon, IEEE Trans. Control Syst. Technol., 2013).

The torque of a simulated arm in a position loop is compared with the measured one. With gains that follow the model,
the simulated motion hardly depends on the parameters, and Gauss-Newton is least squares on the regressor of that
motion, repeated. The controller is a stand-in (`ident.simulation.closed_loop`), its reference the recorded motion or
the recorded target positions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from drivers.core.errors import IdentificationError
from ident.estimators.estimator import Estimation, EstimationLoop, Estimator, Setup
from ident.estimators.method import Method, within
from ident.estimators.simulated_arm import SIMULATION_SETTLED, check_whole_arm, simulated_motions
from ident.estimators.target_motion import target_motions
from ident.estimators.torque_estimator import TorqueEstimator, reduce_torques
from ident.ranges import LOOP_BANDWIDTH
from ident.regression.comparison import compare_torques
from ident.regression.jackknife import CorrectedCovariance, FilteredRun, block_jackknife
from ident.regression.least_squares import LeastSquares, weighted_least_squares
from ident.regression.observation_matrix import Reduction
from ident.signals.prepared import Prepared, Segment

SIMULATIONS = 20


@dataclass(frozen=True)
class DidimOptions:
    """Options of DIDIM."""

    bandwidth: Annotated[
        float | None,
        within(LOOP_BANDWIDTH),
        Field(description="of the simulated position loop [rad/s]; twenty times the motion's band if absent"),
    ] = None
    reference: Annotated[
        Literal["recorded", "target"],
        Field(description="what the simulated loop follows: the recorded motion, or the recorded target positions"),
    ] = "recorded"


@dataclass(frozen=True, eq=False, kw_only=True)
class SimulatedEstimation(Estimation):
    """An estimate with the motion that it was made on.

    Attributes:
        motions: of each run, its segments with the simulated motion.
    """

    motions: tuple[tuple[Segment, ...], ...]


@dataclass(frozen=True)
class DidimEstimator(TorqueEstimator):
    """Weighted least squares along the motion of the simulated arm.

    Attributes:
        options: of the simulated loop.
    """

    options: DidimOptions

    def estimate(self, runs: Sequence[Prepared], plain: Reduction, active: Sequence[int]) -> Estimation:
        """Simulate, fit, and so on."""
        setup = self.setup
        references = self._references(runs)
        reduction, solution = plain, self.solve(plain, active)
        changes: list[float] = []
        while len(changes) < SIMULATIONS and (not changes or changes[-1] > SIMULATION_SETTLED):
            motions = simulated_motions(setup, references, reduction, solution, self.options.bandwidth)
            simulated = [replace(run, segments=segments) for run, segments in zip(runs, motions, strict=True)]
            reduction = reduce_torques(setup.kernel, simulated, setup.experiment.torques)
            refined = self.solve(reduction, active)
            moved = np.abs(refined.parameters - solution.parameters)[list(active)]
            changes.append(float(np.max(moved / refined.std[list(active)])))
            solution = refined
        loop = EstimationLoop("simulation and fit", "σ", tuple(changes), changes[-1] <= SIMULATION_SETTLED)
        return SimulatedEstimation(
            setup.kernel,
            reduction,
            replace(solution, method="didim"),
            (loop,),
            passes=1 + len(changes),
            motions=tuple(motions),
        )

    def _references(self, runs: Sequence[Prepared]) -> Sequence[Prepared]:
        """The runs with the motion that the simulated loop follows.

        Raises:
            IdentificationError: a recording has no targets, and they were asked for.
        """
        if self.options.reference == "recorded":
            return runs
        targets = target_motions(runs)
        if targets is None:
            raise IdentificationError(
                "a recording holds no target positions of all joints", hint="use --method didim:reference=recorded"
            )
        return [replace(run, segments=segments) for run, segments in zip(runs, targets, strict=True)]

    def covariance(self, runs: Sequence[FilteredRun], estimation: Estimation) -> CorrectedCovariance:
        """Delete-block jackknife of the last fit, the simulated motion held."""
        assert isinstance(estimation, SimulatedEstimation)
        kernel = estimation.kernel
        simulated = [
            FilteredRun(
                segments,
                run.parallel_filter,
                compare_torques(
                    kernel.model, kernel.columns, estimation.solution.parameters, segments, run.parallel_filter
                ),
            )
            for run, segments in zip(runs, estimation.motions, strict=True)
        ]
        return block_jackknife(kernel, simulated, estimation.solution)

    def restricted(self, estimation: Estimation, columns: Sequence[int]) -> LeastSquares:
        """The last fit of fewer columns."""
        return replace(self.solve(estimation.reduction, columns), method="didim")


def _estimator(options: DidimOptions, setup: Setup) -> Estimator:
    check_whole_arm(setup, "didim")
    return DidimEstimator(setup, weighted_least_squares, options)


METHOD = Method(
    "torque of a simulated arm that follows the recorded motion or its targets, compared with the measured one",
    "torque",
    DidimOptions,
    _estimator,
)
