"""Friction with unknown shapes, load torque, terms or travels, settled before the regression, which is then linear.

Shapes and load torque are those of `ident.friction.solver`; the search begins at the best shapes of a grid. Pre-sliding
travels follow, and all other parameters are estimated with them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from drivers.core.reading_process import Progress
from ident.assessment.excitation import excited_base_columns
from ident.friction.solver import Value, settle
from ident.friction.terms import NO_TERMS, FrictionTerms, LoadTorque, no_terms
from ident.identify.friction.candidates import (
    FOLDS,
    Candidate,
    candidates_of,
    greatest_speeds,
    motor_motion,
    position_candidates,
)
from ident.identify.friction.extensions import (
    LEAST_MOTIONS,
    LEVEL,
    choose_position_terms,
    delivered_errors,
    falls,
    find_travels,
    motion_folds,
)
from ident.identify.friction.rows import FrictionRows
from ident.identify.friction.selection import FrictionSearch
from ident.identify.identification import FrictionFit, IdentifyChoices
from ident.identify.preparation import PreparedData, compare_run
from ident.model.base_parameters import BaseParameters, gravity_of
from ident.model.dynamic_model import DynamicModel
from ident.model.joint_columns import combined, own_column
from ident.model.presliding import dry_friction
from ident.model.regressor import RegressorKernel, load_change
from ident.regression.comparison import TorqueSeries, independent_share, residual_autocorrelation
from ident.regression.jackknife import distinct_samples
from ident.regression.least_squares import LeastSquares, LinearMethod, ordinary_least_squares, weighted_least_squares
from ident.regression.observability import Experiment, experiment_base
from ident.regression.observation_matrix import Reduction
from ident.result.friction import FrictionStep
from ident.result.schema import PreslidingTravel

TRAVEL_ROUNDS = 2
"""Rounds of travels and all other parameters in turn; the second moves them by a fraction of the first."""

LEAST_REVERSALS = 3
"""Different velocity reversals that a motor's data must hold before its friction gets further terms: a curve over the
velocity needs more than one passage through it."""

MOVING_SHARE = 0.05
"""Share of a velocity's root mean square that a stroke between two reversals exceeds."""


def fit_friction(
    model: DynamicModel,
    prepared: PreparedData,
    experiment: Experiment,
    robot_file: RobotFile,
    choices: IdentifyChoices,
    progress: Progress,
) -> FrictionFit:
    """The model with its friction settled on the identification data.

    Args:
        model: with the terms that are asked for; as it is where nothing is unknown of them.
        prepared: the data; held-out parts take no part.
        experiment: locked joints, and motors whose torques are used.
        robot_file: of the arm.
        choices: the user's.
        progress: called before each step.

    Raises:
        DataError: the friction depends on a temperature that was not recorded.
    """
    automatic = choices.chooses_friction(robot_file.robot.friction)
    terms = model.terms
    if not (automatic or terms.shaped or terms.loaded or choices.finds_travels(model)):
        return FrictionFit(model)
    progress("friction")
    fit = _Fit(model, prepared, experiment, "ols" if choices.estimator.name == "ols" else "wls")
    friction = FrictionFit(model)
    if automatic:
        friction = fit.with_position(fit.automatic(model, robot_file, progress), robot_file, progress)
    elif terms.shaped or terms.loaded:
        terms = fit.started(terms) if terms.shaped else terms
        progress("friction shapes" if terms.shaped else "load torque")
        friction = fit.settled(replace(model, terms=terms))
    if choices.finds_travels(model):
        progress("presliding")
        friction = fit.with_travels(friction)
    return friction


@dataclass(frozen=True)
class _Solved:
    """A model's least-squares solution."""

    model: DynamicModel
    base: BaseParameters
    reduction: Reduction
    solution: LeastSquares

    @property
    def misfit(self) -> float:
        """Return what falls as the fit improves: Σ log σ of all motors' residuals, or the squared residuals of OLS."""
        spread = self.solution.joint_std
        if self.solution.method == "ols":
            return self.solution.residual_sum
        return float(np.sum(np.log(spread[spread > 0.0])))

    def value(self, kind: str, motor: int) -> float | None:
        """Value of a motor's own parameter of a kind; None where it was not estimated."""
        column = self.column(kind, motor)
        return None if column is None else float(self.solution.parameters[column])

    def column(self, kind: str, motor: int) -> int | None:
        """Base column of a motor's own parameter of a kind; None where it was not estimated."""
        column = own_column(self.model, self.base.columns, kind, motor)
        return column if column in self.solution.active else None

    @property
    def load_torque(self) -> LoadTorque:
        """Return what the links' parameters say of gravity."""
        return gravity_of(self.base, self.solution.parameters)


class _Fit:
    """Solutions on the identification data."""

    def __init__(
        self, model: DynamicModel, prepared: PreparedData, experiment: Experiment, method: LinearMethod
    ) -> None:
        self._prepared, self._runs = prepared.runs, [run.prepared for run in prepared.runs]
        self._experiment, self._method = experiment, method
        self._weights: FloatArray | None = None
        self._plain = replace(model, terms=NO_TERMS, presliding=())
        plain_base = experiment_base(self._plain, [experiment])
        self._rows = FrictionRows(self._plain, plain_base, self._runs)
        self._bases = {tuple(parameter.name for parameter in self._plain.parameters): plain_base}

    def base(self, model: DynamicModel) -> BaseParameters:
        """Base parameters of a model; those of models with the same columns are the same."""
        names = tuple(parameter.name for parameter in model.parameters)
        if names not in self._bases:
            self._bases[names] = experiment_base(model, [self._experiment])
        return self._bases[names]

    def solve(self, model: DynamicModel) -> _Solved:
        base = self.base(model)
        reduction = self._rows.reduction(model, base, self._experiment.torques)
        active = excited_base_columns(reduction, base, self._runs)
        if self._method == "ols":
            return _Solved(model, base, reduction, ordinary_least_squares(reduction, active))
        solution = weighted_least_squares(reduction, active, self._weights)
        self._weights = solution.weights
        return _Solved(model, base, reduction, solution)

    def automatic(self, model: DynamicModel, robot_file: RobotFile, progress: Progress) -> FrictionFit:
        """Terms and shapes chosen for each motor, where the model that is delivered gains by them."""
        plain = self._plain
        solved = self.solve(plain)
        series = self._series(solved)
        samples = distinct_samples(series)
        folds = [_folds(indices, samples.count) for indices in samples.indices]
        start = replace(no_terms(plain.dof), load_torque=solved.load_torque)
        search = self._search(replace(plain, terms=start), solved, series)
        enough = self._reversing(samples.share)
        steps = [step for motor in enough for step in search.choose(motor, plain.joint_names[motor])]
        terms = search.terms(start)
        if not any(step.accepted for step in steps):
            return FrictionFit(model, tuple(steps))
        progress("friction shapes" if terms.shaped else "load torque")
        settled = self.settled(replace(model, terms=terms))
        errors, sizes = self._delivered(solved, settled.model, robot_file, folds)
        kept = settled if falls(*errors) else FrictionFit(model)
        return replace(kept, steps=tuple(steps), delivered=sizes)

    def with_position(self, friction: FrictionFit, robot_file: RobotFile, progress: Progress) -> FrictionFit:
        """The friction with terms of the position, where several motions call for them."""
        plain = self.solve(friction.model)
        folds = motion_folds(self._series(plain), [len(run.segments) for run in self._runs])
        motions = 1 + max(int(fold[0]) for fold in folds if len(fold))
        if motions < LEAST_MOTIONS:
            return friction
        progress("friction over the position")
        share = distinct_samples(self._series(plain)).share
        turning = [motor for motor in self._reversing(share) if not friction.model.sliding[motor]]
        candidates, names = position_candidates(friction.model.dof), friction.model.joint_names
        terms = friction.model.terms
        terms = terms if terms.kinds else replace(terms, kinds=no_terms(friction.model.dof).kinds)
        solved, accepted = plain, list[FrictionStep]()
        while True:  # what one joint lacks hides what others lack
            rich, search = (
                self._search(solved.model, solved, self._series(solved), candidates, folds) for _ in range(2)
            )
            choose_position_terms(rich, turning, terms, names, np.inf)
            richest = self.solve(replace(friction.model, terms=rich.terms(terms)))
            # The residuals of every term that might be there say how many equations are independent.
            search.judge_by(self._shares(self._series(richest)))
            steps = choose_position_terms(search, turning, terms, names, LEVEL)
            if not any(step.accepted for step in steps):
                break
            accepted += [step for step in steps if step.accepted]
            terms = search.terms(terms)
            solved = self.solve(replace(friction.model, terms=terms))
        friction = replace(friction, steps=(*friction.steps, *accepted, *steps))
        if not accepted:
            return friction
        settled = self.settled(solved.model) if terms.shaped or terms.loaded else replace(friction, model=solved.model)
        (before, after), sizes = self._delivered(plain, settled.model, robot_file, folds)
        friction = replace(friction, by_run=sizes)
        used = min(motions, FOLDS)
        if not (np.all(after[:used] < before[:used]) and falls(before[:used], after[:used])):
            return friction
        return replace(friction, model=settled.model, rounds=settled.rounds, settled=settled.settled)

    def _delivered(
        self, solved: _Solved, other: DynamicModel, robot_file: RobotFile, folds: Sequence[npt.NDArray[np.int64]]
    ) -> tuple[tuple[FloatArray, FloatArray], tuple[float, float]]:
        """Squared errors (FOLDS,) of two consistent models on folds left out, and their root mean squares [σ]."""
        before, after = (
            delivered_errors(
                self._rows,
                solve.model,
                solve.base,
                solve.reduction,
                solve.solution,
                robot_file,
                solved.solution.weights,
                folds,
            )
            for solve in (solved, self.solve(other))
        )
        size_before, size_after = (float(np.sqrt(np.sum(error) / solved.solution.rows)) for error in (before, after))
        return (before, after), (size_before, size_after)

    def _reversing(self, share: float) -> list[int]:
        """Motors with Coulomb and viscous friction and enough reversals for more, of which a share is different."""
        return [
            motor
            for motor in self._experiment.torques
            if self._plain.viscous[motor]
            and self._plain.coulomb[motor]
            and self._reversals(motor) * share >= LEAST_REVERSALS
        ]

    def _reversals(self, motor: int) -> int:
        """Velocity reversals of a motor in the data."""
        count = 0
        for run in self._runs:
            for segment in run.segments:
                velocity = combined(motor_motion(self._plain, motor).motion, segment.velocity)[segment.used]
                moving = velocity[np.abs(velocity) > MOVING_SHARE * np.sqrt(np.mean(np.square(velocity)))]
                count += int(np.count_nonzero(np.diff(np.sign(moving))))
        return count

    def _series(self, solved: _Solved, *, presliding: bool = True) -> list[TorqueSeries]:
        """Torques of a solution, a series per segment."""
        model = solved.model if presliding else replace(solved.model, presliding=())
        kernel = RegressorKernel(model, solved.base.columns)
        return [torque for run in self._prepared for torque in compare_run(kernel, solved.solution.parameters, run)]

    def with_travels(self, friction: FrictionFit) -> FrictionFit:
        """The model with pre-sliding travels, and its shapes settled with them."""
        runs = [(run.segments, run.parallel_filter) for run in self._runs]
        travels: tuple[PreslidingTravel, ...] = ()
        for _ in range(TRAVEL_ROUNDS):
            solved = self.solve(friction.model)
            series = self._series(solved, presliding=False)
            dry = dry_friction(solved.model, solved.base, solved.solution.parameters)
            travels = find_travels(dry, runs, series)
            if not travels and not friction.model.presliding:
                break
            model = replace(friction.model, presliding=tuple((travel.parameter, travel.travel) for travel in travels))
            if model.terms.shaped or model.terms.loaded:
                friction = replace(friction, model=self.settled(model).model)
            else:
                friction = replace(friction, model=model)
        return replace(friction, travels=travels)

    def started(self, terms: FrictionTerms) -> FrictionTerms:
        """The terms with free shapes from the best of a grid."""
        without = terms.without_free_shapes()
        model = replace(self._plain, terms=without)
        if terms.loaded:
            model = replace(model, terms=replace(without, load_torque=self.solve(model).load_torque))
        solved = self.solve(model)
        search = self._search(model, solved, self._series(solved))
        for motor in (*self._experiment.torques, *self._experiment.torques):  # the second time beside all others
            search.start_shapes(motor, [shape.name for shape, of in terms.free_shapes() if of == motor])
        return search.terms(without)

    def _search(
        self,
        model: DynamicModel,
        solved: _Solved,
        series: Sequence[TorqueSeries],
        candidates: tuple[tuple[Candidate, ...], ...] = (),
        folds: Sequence[npt.NDArray[np.int64]] = (),
    ) -> FrictionSearch:
        """Choices among candidates on these data.

        Args:
            model: has the load torque, where there are to be load candidates.
            solved: the model, or without its load torque.
            series: its torques.
            candidates: of each motor; if empty, all that do not depend on the position.
            folds: block of each filtered sample; if empty, consecutive samples.
        """
        samples = distinct_samples(series)
        folds = folds or [_folds(indices, samples.count) for indices in samples.indices]
        segments = [segment for run in self._runs for segment in run.segments]
        heat = [segment.temperature for segment in segments if segment.temperature is not None]
        warmed = float(np.ptp(np.concatenate(heat, axis=1), axis=1).min()) if len(heat) == len(segments) else 0.0
        candidates = candidates or candidates_of(model, greatest_speeds(model, self._runs), warmed)
        return FrictionSearch(
            self._rows.candidate_grams(model, solved.base, folds, candidates),
            solved.solution.active,
            [solved.column("viscous", motor) for motor in range(model.dof)],
            [solved.column("coulomb", motor) for motor in range(model.dof)],
            self._experiment.torques,
            self._shares(series),
        )

    def _shares(self, series: Sequence[TorqueSeries]) -> FloatArray:
        """Return how many independent equations each motor's are worth (n,), per equation."""
        independent = [independent_share(value[None]) for value in residual_autocorrelation(series)]
        return np.array(independent) * distinct_samples(series).share

    def settled(self, model: DynamicModel) -> FrictionFit:
        """The model with load torque and shapes iterated until they do not change."""
        start = self.solve(replace(model, terms=replace(model.terms, load_torque=None)))
        settled = settle(self, replace(start, model=model))
        return FrictionFit(settled.fit.model, rounds=settled.rounds, settled=settled.converged)

    # What follows makes it a `FrictionProblem`.

    def terms(self, fit: _Solved) -> FrictionTerms:
        return fit.model.terms

    def value(self, fit: _Solved) -> Value:
        return fit.value

    def linearised(self, fit: _Solved) -> Value:
        return self.fitted(fit, replace(fit.model.terms, sensitivities=True)).value

    def fitted(self, fit: _Solved, terms: FrictionTerms) -> _Solved:
        return self.solve(replace(fit.model, terms=terms))

    def no_worse(self, fit: _Solved, before: _Solved) -> bool:
        return fit.misfit <= before.misfit

    def reloaded(self, fit: _Solved) -> tuple[Callable[[], _Solved], float]:
        loaded = replace(fit.model.terms, load_torque=fit.load_torque)
        change = load_change(fit.model, self._runs, fit.model.terms, loaded)
        return lambda: self.fitted(fit, loaded), change


def _folds(indices: npt.NDArray[np.int64], count: int) -> npt.NDArray[np.int64]:
    """Fold of each filtered sample: consecutive samples, repeated phases of a motion in the same one."""
    return np.minimum(indices * FOLDS // max(count, 1), FOLDS - 1)
