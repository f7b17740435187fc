"""The estimators behind `--method`: from prepared data to a reduced system, its solution and its error bars.

`ols` and `wls` solve the joints' torque equations (SR400 eq. 13), `energy` and `power` the scalar equation of the whole
arm's energy (SR400 eq. 10) or its derivative. All work in the base parameters of the dynamic model: whatever has no
effect on the torque has none on the energy, so they are enough for both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from drivers.errors import UsageError
from ident.assessment.plausibility import critical_variance_ratio, refitted
from ident.estimators.energy_equations import EnergyEquations, energy_jackknife, independent_rows, reduce_energy
from ident.estimators.energy_windows import (
    EnergyWindows,
    describe_windows,
    exchange_for,
    mean_duration,
    moving_spans,
)
from ident.estimators.power import PowerSamples
from ident.model.base_parameters import BaseParameters
from ident.model.dynamic_model import DynamicModel
from ident.model.energy import EnergyKernel, energy_base_parameters
from ident.model.regressor import RegressorKernel
from ident.regression.jackknife import CorrectedCovariance, FilteredRun, block_jackknife
from ident.regression.least_squares import (
    ENERGY_METHODS,
    LeastSquares,
    LinearMethod,
    Method,
    ordinary_least_squares,
    weighted_least_squares,
)
from ident.regression.observation_matrix import Reduction, reduce_segments, stack_reductions
from ident.signals.prepared import Prepared, Step


class Estimator(Protocol):
    """One way to estimate base parameters."""

    def notes(self, run: Prepared) -> tuple[Step, ...]:
        """Its processing of the data before the regression, for the list of steps."""

    def reduce(self, runs: Sequence[Prepared]) -> Reduction:
        """The system of all data."""

    def solve(self, reduction: Reduction, active: Sequence[int]) -> LeastSquares:
        """Its solution for the active base columns."""

    def covariance(self, runs: Sequence[FilteredRun], solution: LeastSquares) -> CorrectedCovariance:
        """Covariance of a solution's active parameters, for autocorrelated residuals."""


@dataclass(frozen=True)
class TorqueEstimator:
    """Least squares on the joints' torques."""

    kernel: RegressorKernel
    method: LinearMethod

    def notes(self, run: Prepared) -> tuple[Step, ...]:
        """Nothing that is not in the list."""
        return ()

    def reduce(self, runs: Sequence[Prepared]) -> Reduction:
        """One factor per joint."""
        return stack_reductions([reduce_segments(self.kernel, run.segments, run.parallel_filter) for run in runs])

    def solve(self, reduction: Reduction, active: Sequence[int]) -> LeastSquares:
        """OLS or WLS."""
        if self.method == "ols":
            return ordinary_least_squares(reduction, active)
        return weighted_least_squares(reduction, active)

    def covariance(self, runs: Sequence[FilteredRun], solution: LeastSquares) -> CorrectedCovariance:
        """Delete-block jackknife."""
        return block_jackknife(self.kernel, runs, solution)


@dataclass(frozen=True)
class EnergyEstimator:
    """Least squares on the arm's energy."""

    equations: EnergyEquations
    method: Method

    def notes(self, run: Prepared) -> tuple[Step, ...]:
        """The energy windows, where there are any."""
        if not isinstance(self.equations, EnergyWindows):
            return ()
        count, duration = describe_windows(self.equations, run.segments)
        exchange = self.equations.exchange
        text = (
            f"{count} windows that each exchange {exchange:.3g} J between motors and arm, {duration:.3g} s long on "
            f"average; each instant belongs to {self.equations.overlap}"
        )
        return (Step("energy windows", {"windows": count, "exchange_j": exchange, "mean_s": duration}, text),)

    def reduce(self, runs: Sequence[Prepared]) -> Reduction:
        """One factor for the whole arm."""
        return stack_reductions([reduce_energy(self.equations, run.segments, run.parallel_filter) for run in runs])

    def solve(self, reduction: Reduction, active: Sequence[int]) -> LeastSquares:
        """OLS: windows of equal exchange have equal weight."""
        return replace(ordinary_least_squares(reduction, active), method=self.method)

    def covariance(self, runs: Sequence[FilteredRun], solution: LeastSquares) -> CorrectedCovariance:
        """Delete-block jackknife over time."""
        return energy_jackknife(self.equations, runs, solution)


def estimator_of(
    method: Method, kernel: RegressorKernel, runs: Sequence[Prepared], window: float | None = None
) -> Estimator:
    """The estimator of a method's name.

    Args:
        method: its name.
        kernel: of the torque equations' base columns; the energy's are the same.
        runs: the data, from which the energy windows' exchange follows.
        window: mean duration of the energy windows [s]; from the parallel filter's cut-off and the data where None.

    Raises:
        DataError: no energy is exchanged in the data.
        UsageError: windows longer than the data.
    """
    if method == "ols" or method == "wls":
        return TorqueEstimator(kernel, method)
    energy = EnergyKernel(kernel.model, kernel.columns)
    if method == "power":
        return EnergyEstimator(PowerSamples(energy), method)
    segments = [segment for run in runs for segment in run.segments]
    if window is not None:
        longest = max((span.stop - span.start) / s.rate for s in segments for span in moving_spans(s))
        if window > longest:
            raise UsageError(
                f"windows of {window:g} s do not fit into the data, whose longest motion lasts {longest:.3g} s",
                where="energy_window",
            )
    duration = mean_duration(energy, segments, runs[0].cutoffs.torque) if window is None else window
    return EnergyEstimator(EnergyWindows(energy, exchange_for(kernel.model, segments, duration)), method)


def estimable(method: Method, model: DynamicModel, base: BaseParameters) -> tuple[int, ...]:
    """Indices of the base parameters that a method's equations can identify, whatever the data."""
    if method not in ENERGY_METHODS:
        return tuple(range(base.count))
    kept = set(energy_base_parameters(model).columns)
    return tuple(index for index, column in enumerate(base.columns) if column in kept)


def fits_energy_better(
    other: Estimator, runs: Sequence[Prepared], active: Sequence[int], residual_sum: float, independent: float
) -> bool:
    """Whether another energy model's residual is significantly smaller than `residual_sum`.

    Args:
        other: of the other model's equations; the torque equations' never fit better in this sense.
        runs: the data.
        active: base columns to fit.
        residual_sum: of the model in question.
        independent: equations that its residuals are worth; the better model's are whiter, and count if they are more.
    """
    if not isinstance(other, EnergyEstimator):
        return False
    solution = refitted(other.reduce(runs), active)
    rows = max(independent, independent_rows(other.equations, runs, solution.parameters))
    return solution.residual_sum < critical_variance_ratio(rows - len(active)) * residual_sum
