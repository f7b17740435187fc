"""Least squares on the scalar equation of the whole arm's energy (SR400 eq. 10) or its derivative."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ident.assessment.plausibility import critical_variance_ratio, refitted
from ident.estimators.energy.equations import EnergyEquations, energy_jackknife, independent_rows, reduce_energy
from ident.estimators.energy.windows import EnergyWindows, describe_windows
from ident.estimators.estimator import Estimation, Estimator, Setup
from ident.model.base_parameters import BaseParameters
from ident.model.dynamic_model import DynamicModel
from ident.model.dynamics.energy import energy_base_parameters
from ident.regression.jackknife import CorrectedCovariance, FilteredRun
from ident.regression.least_squares import LeastSquares, ordinary_least_squares
from ident.regression.observation_matrix import Reduction, stack_reductions
from ident.signals.prepared import Prepared, Step


@dataclass(frozen=True)
class EnergyEstimator:
    """Least squares on the arm's energy.

    Attributes:
        setup: the data.
        equations: of the energy.
        name: of the method.
    """

    setup: Setup
    equations: EnergyEquations
    name: str

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

    def estimate(self, runs: Sequence[Prepared], plain: Reduction, active: Sequence[int]) -> Estimation:
        """OLS: windows of equal exchange have equal weight."""
        return Estimation(self.setup.kernel, plain, self._solve(plain, active))

    def covariance(self, runs: Sequence[FilteredRun], estimation: Estimation) -> CorrectedCovariance:
        """Delete-block jackknife over time."""
        return energy_jackknife(self.equations, runs, estimation.solution)

    def restricted(self, estimation: Estimation, columns: Sequence[int]) -> LeastSquares:
        """OLS of fewer columns."""
        return self._solve(estimation.reduction, columns)

    def _solve(self, reduction: Reduction, active: Sequence[int]) -> LeastSquares:
        return replace(ordinary_least_squares(reduction, active), method=self.name)


def estimable(model: DynamicModel, base: BaseParameters) -> tuple[int, ...]:
    """Indices of the base parameters that the energy's equations can identify, whatever the data."""
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
