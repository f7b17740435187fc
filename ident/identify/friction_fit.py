"""Friction with unknown shapes, load torque or terms, settled before the regression, which is then linear.

The load torque comes from the gravity parameters of the estimate before (AUBO eq. 18), until it does not change. The
shapes, exponent α and Stribeck velocity v_s, are found by variable projection: Gauss-Newton on the shapes, all linear
parameters estimated anew at each of them, with exact derivatives ∂τ/∂α and ∂τ/∂v_s as columns of the regression
(Golub and Pereyra, Inverse Problems 19, 2003). The search begins at the best shapes of a grid.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from drivers.reading_process import Progress
from ident.assessment.excitation import excited_base_columns
from ident.estimators.friction_steps import (
    LOAD_TOLERANCE,
    SHAPE_TOLERANCE,
    braking,
    gravity_of,
    load_change,
    own_column,
    shortened_step,
)
from ident.estimators.torque_estimator import reduce_torques
from ident.identify.data_split import DataSplit
from ident.identify.friction.candidates import FOLDS, candidate_grams, candidates_of, greatest_speeds
from ident.identify.friction.choice import AUTO
from ident.identify.friction.selection import FrictionSearch, FrictionStep
from ident.identify.identification import FrictionFit, IdentifyChoices
from ident.identify.preparation import prepare_data
from ident.model.base_parameters import BaseParameters
from ident.model.dynamic_model import DynamicModel
from ident.model.friction_terms import FrictionTerms, LoadTorque, no_terms
from ident.model.regressor import RegressorKernel
from ident.regression.autocorrelation import independent_share, residual_autocorrelation
from ident.regression.comparison import compare_torques
from ident.regression.jackknife import distinct_samples
from ident.regression.least_squares import (
    LeastSquares,
    LinearMethod,
    ordinary_least_squares,
    weighted_least_squares,
)
from ident.regression.observability import Experiment, experiment_base
from ident.signals.prepared import Prepared

ROUNDS = 20
"""Of Gauss-Newton steps and new load torques."""


def fit_friction(
    model: DynamicModel, data: DataSplit, experiment: Experiment, choices: IdentifyChoices, progress: Progress
) -> FrictionFit:
    """The model with its friction settled on the identification data.

    Args:
        model: with the terms that are asked for; as it is where nothing is unknown of them.
        data: held-out parts take no part.
        experiment: locked joints, and motors whose torques are used.
        choices: the user's.
        progress: called before each step.

    Raises:
        DataError: the friction depends on a temperature that was not recorded.
    """
    automatic = choices.model.friction == AUTO
    terms = no_terms(model.dof) if model.terms is None else model.terms
    if not automatic and not terms.shaped and not terms.loaded:
        return FrictionFit(model)
    progress("friction")
    for run in data.identification:
        heat = run.signals.temperature
        model.require_temperature(None if heat is None else heat.T, run.signals.label)
    plain = replace(model, terms=None)
    kernel = RegressorKernel(plain, experiment_base(plain, [experiment]).columns)
    prepared = prepare_data(kernel, replace(data, held_out=()), experiment.torques, (), choices, progress)
    fit = _Fit([run.prepared for run in prepared.runs], experiment, "ols" if choices.estimator.name == "ols" else "wls")
    steps: tuple[FrictionStep, ...] = ()
    if automatic:
        terms, steps = fit.chosen(plain)
    elif terms.shaped:
        terms = fit.started(plain, terms)
    progress("friction shapes" if terms.shaped else "load torque")
    settled = fit.settled(replace(model, terms=terms))
    return replace(settled, steps=steps)


@dataclass(frozen=True)
class _Solved:
    """A model's least-squares solution."""

    model: DynamicModel
    base: BaseParameters
    solution: LeastSquares

    @property
    def misfit(self) -> float:
        """What falls as the fit improves: Σ log σ of all motors' residuals, or the squared residuals of OLS."""
        spread = self.solution.joint_std
        if self.solution.method == "ols":
            return self.solution.residual_sum
        return float(np.sum(np.log(spread[spread > 0.0])))

    def value(self, kind: str, motor: int) -> float | None:
        """Of a motor's own parameter of a kind; None where it was not estimated."""
        column = self.column(kind, motor)
        return None if column is None else float(self.solution.parameters[column])

    def column(self, kind: str, motor: int) -> int | None:
        """Base column of a motor's own parameter of a kind; None where it was not estimated."""
        column = own_column(self.model, self.base.columns, kind, motor)
        return column if column in self.solution.active else None

    @property
    def brakes(self) -> bool:
        """Whether friction with an estimated exponent brakes."""
        return self.model.terms is None or braking(self.model.terms, self.value)

    @property
    def load_torque(self) -> LoadTorque:
        """What the links' parameters say of gravity."""
        return gravity_of(self.base, self.solution.parameters)


class _Fit:
    """Solutions on the identification data."""

    def __init__(self, runs: Sequence[Prepared], experiment: Experiment, method: LinearMethod) -> None:
        self._runs, self._experiment, self._method = runs, experiment, method

    def solve(self, model: DynamicModel) -> _Solved:
        base = experiment_base(model, [self._experiment])
        reduction = reduce_torques(RegressorKernel(model, base.columns), self._runs, self._experiment.torques)
        solve = ordinary_least_squares if self._method == "ols" else weighted_least_squares
        return _Solved(model, base, solve(reduction, excited_base_columns(reduction, base, self._runs)))

    def chosen(self, plain: DynamicModel) -> tuple[FrictionTerms, tuple[FrictionStep, ...]]:
        """Terms and shapes chosen for each motor, and the steps that were tried."""
        solved = self.solve(plain)
        start = replace(no_terms(plain.dof), load_torque=solved.load_torque)
        search = self._search(replace(plain, terms=start), solved)
        names = plain.joint_names
        steps = [step for motor in self._experiment.torques for step in search.choose(motor, names[motor])]
        return search.terms(start), tuple(steps)

    def started(self, plain: DynamicModel, terms: FrictionTerms) -> FrictionTerms:
        """The terms with free shapes from the best of a grid."""
        without = replace(
            terms,
            exponent=tuple(
                1.0 if free else value for free, value in zip(terms.free_exponent, terms.exponent, strict=True)
            ),
            stribeck=tuple(
                wanted and not free for wanted, free in zip(terms.stribeck, terms.free_stribeck_velocity, strict=True)
            ),
        )
        model = replace(plain, terms=without)
        if terms.loaded:
            model = replace(plain, terms=replace(without, load_torque=self.solve(model).load_torque))
        search = self._search(model, self.solve(model))
        for motor in (*self._experiment.torques, *self._experiment.torques):  # the second time beside all others
            search.start_shapes(motor, terms.free_exponent[motor], terms.free_stribeck_velocity[motor])
        return search.terms(without)

    def _search(self, model: DynamicModel, solved: _Solved) -> FrictionSearch:
        """Choices among all candidates on these data."""
        kernel = RegressorKernel(model, solved.base.columns)
        series = [
            part
            for run in self._runs
            for part in compare_torques(
                model, solved.base.columns, solved.solution.parameters, run.segments, run.parallel_filter
            )
        ]
        samples = distinct_samples(series)
        folds = [_folds(indices, samples.count) for indices in samples.indices]
        heat = [segment.temperature for run in self._runs for segment in run.segments]
        known = all(values is not None and bool(np.all(np.isfinite(values))) for values in heat)
        candidates = candidates_of(model, greatest_speeds(model, self._runs), temperature=known)
        shares = np.array([independent_share(one[None]) for one in residual_autocorrelation(series)]) * samples.share
        return FrictionSearch(
            candidate_grams(kernel, self._runs, folds, candidates),
            solved.solution.active,
            [solved.column("viscous", motor) for motor in range(model.dof)],
            [solved.column("coulomb", motor) for motor in range(model.dof)],
            self._experiment.torques,
            shares,
        )

    def settled(self, model: DynamicModel) -> FrictionFit:
        """The model with load torque and shapes iterated until they do not change."""
        terms = model.terms
        assert terms is not None
        solved = self.solve(replace(model, terms=replace(terms, load_torque=None)))
        for rounds in range(1, ROUNDS + 1):
            of_load = of_shapes = 0.0
            if terms.loaded:
                loaded = replace(terms, load_torque=solved.load_torque)
                of_load = load_change(model, self._runs, terms, loaded)
                terms = loaded
                solved = self.solve(replace(model, terms=terms))
            if terms.shaped:
                solved, of_shapes = self._step(solved)
                assert solved.model.terms is not None
                terms = solved.model.terms
            if of_load < LOAD_TOLERANCE and of_shapes < SHAPE_TOLERANCE:
                return FrictionFit(solved.model, rounds=rounds)
        return FrictionFit(solved.model, rounds=ROUNDS, settled=False)

    def _step(self, solved: _Solved) -> tuple[_Solved, float]:
        """One Gauss-Newton step of the shapes, shortened until it improves the fit; largest relative change."""
        terms = solved.model.terms
        assert terms is not None
        linear = self.solve(replace(solved.model, terms=replace(terms, sensitivities=True)))

        def improved(moved: FrictionTerms) -> _Solved | None:
            candidate = self.solve(replace(solved.model, terms=moved))
            better = candidate.misfit <= solved.misfit and (candidate.brakes or not solved.brakes)
            return candidate if better else None

        found, change = shortened_step(terms, linear.value, improved)
        return found or solved, change


def _folds(indices: npt.NDArray[np.int64], count: int) -> npt.NDArray[np.int64]:
    """Fold of each filtered sample: consecutive samples, repeated phases of a motion in the same one."""
    return np.minimum(indices * FOLDS // max(count, 1), FOLDS - 1)
