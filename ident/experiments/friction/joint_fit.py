"""Friction of one joint from its periods: terms chosen, shapes and load torque settled, error bars.

Every period has its own inertia and first moments (`single_joint`); friction is common to all. Terms and shapes are
found as in an identification (`ident.identify.friction.selection`, `friction_fit`): by held-out error and partial
F-test, by variable projection; the load torque is the gravity torque of the fit before (AUBO eq. 18). The covariance is
a delete-block jackknife of all parameters together, shapes and the load torque's dependence on the first moments
included to first order. Errors repeat themselves along the motion (friction that the terms do not have) and along the
position (torque ripple): of blocks of either kind, those count that give a parameter the larger variance.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from daq.robot.schema import Friction
from drivers.core.arrays import FloatArray
from drivers.core.errors import IdentificationError
from drivers.core.units import ZERO_CELSIUS
from ident.experiments.friction.joint_data import JointData, JointExperiment
from ident.experiments.friction.single_joint import JointPeriod
from ident.friction.choice import AUTO, chosen_friction, friction_columns
from ident.friction.solver import Value, settle
from ident.friction.table import (
    FURTHER_KINDS,
    LEAST_CURVATURE_SPAN,
    LEAST_TEMPERATURE_SPAN,
    LOAD_KINDS,
    OPTIONS,
    SHAPED,
    TEMPERATURE_KINDS,
    temperature_estimate,
)
from ident.friction.terms import FrictionTerms, friction_terms, no_terms
from ident.identify.friction.candidates import CANDIDATE_KINDS, FOLDS, Candidate, CandidateGrams, term_candidates
from ident.identify.friction.selection import FrictionSearch
from ident.model.dynamic_model import DynamicModel
from ident.regression.comparison import independent_share
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.regression.jackknife import BlockSums, block_length, jackknife_covariance, tolerant_moves
from ident.regression.least_squares import LEAST_TORQUE
from ident.result.friction import FrictionStep, friction_fields
from ident.result.friction_experiment import JointFrictionExperiment, ValueRange

LEAST_LOAD_SHARE = 0.5
"""The load torque must vary by this times the Coulomb friction: gears lose some per cent of the torque that they carry,
so that with less the friction changes by less than what the other terms are wrong by."""

SHARES_OF_A_FOLD = 4
"""Parts of a fold, spread over the motion: each fold has slow and fast strokes."""


@dataclass(frozen=True)
class _Solved:
    """A least-squares solution: nuisance parameters of all periods, then friction of some kinds."""

    terms: FrictionTerms
    columns: FloatArray
    parameters: FloatArray
    residual: FloatArray
    own: int
    kinds: tuple[str, ...]

    def value(self, kind: str, motor: int) -> float | None:
        """Value of a parameter of a kind; None where there is no such column. `motor` is 0."""
        return float(self.parameters[self.own + self.kinds.index(kind)]) if kind in self.kinds else None


def fit_joint(
    model: DynamicModel, name: str, periods: Sequence[JointPeriod], friction: str, section: Friction
) -> JointExperiment:
    """Friction of the joint of these periods.

    Raises:
        IdentificationError: the periods do not determine even plain friction.
    """
    fit = _JointFit(model, name, periods, friction)
    terms, steps = fit.chosen() if friction == AUTO else fit.given(section, friction)
    solved, settled = fit.settled(terms)
    return fit.result(solved, steps, settled)


class _JointFit:
    """The data of one joint, and what is tried on them."""

    def __init__(self, model: DynamicModel, name: str, periods: Sequence[JointPeriod], friction: str) -> None:
        self._data, self._name = JointData(model, periods), name
        self._base: tuple[str, ...] = tuple(
            kind for kind in ("coulomb", "viscous") if kind in friction_columns(friction)
        )
        sliding = model.joints[model.joint_names.index(name)].prismatic
        self._sliding, self._unit = sliding, "N" if sliding else "N·m"
        if not sliding:  # else confounded with the weight
            self._base += ("offset",)
        self._load = [np.zeros_like(period.velocity) for period in periods]
        plain = self.solve(no_terms(1))
        self._load = self._data.load_torques(plain.parameters)
        coulomb = plain.value("coulomb", 0) or 0.0
        self.least_load_span = LEAST_LOAD_SHARE * abs(coulomb)
        heat = [period.temperature for period in periods if period.temperature is not None]
        self.temperature = _span(self._data.sampled(heat)) if len(heat) == len(periods) else None
        self._notes: dict[str, str] = {}
        if np.ptp(self._data.torque) <= LEAST_TORQUE:
            self._notes["torque"] = "the torque does not change while this joint moves: it was not measured"
        self._judge_spans()

    def _judge_spans(self) -> None:
        """Whether temperature and load vary enough for their terms."""
        load, least = self.load_span, self.least_load_span
        self.loads = load.width >= least and load.width > 0.0
        if not any(len(period.gravity) for period in self._data.periods):
            self._notes["load"] = "no load term: gravity does not act on this joint"
        elif not self.loads:
            self._notes["load"] = (
                f"no load term: the load torque varies by {load.width:.3g} {self._unit}, at least {least:.3g} are "
                "needed (record other poses, or a weight on the tool)"
            )
        width = 0.0 if self.temperature is None else self.temperature.width
        self.slope, self.curvature = width >= LEAST_TEMPERATURE_SPAN, width >= LEAST_CURVATURE_SPAN
        if self.temperature is None:
            self._notes["temperature"] = "no temperature term: the temperature was not recorded"
        elif not self.curvature:
            what, needed = ("curvature", LEAST_CURVATURE_SPAN) if self.slope else ("term", LEAST_TEMPERATURE_SPAN)
            self._notes["temperature"] = (
                f"no temperature {what}: the temperature spans {width:.3g} K, at least {needed:g} are needed (repeat "
                "the sweep from a cold start)"
            )

    @property
    def load_span(self) -> ValueRange:
        """Range of |τ_L| over all equations."""
        return _span(np.abs(self._data.sampled(self._load)))

    def kinds(self, terms: FrictionTerms) -> tuple[str, ...]:
        """Friction columns for these terms."""
        further = [kind for kind in FURTHER_KINDS if terms.asks(kind, 0)]
        free = [shape.name for shape, _ in terms.free_shapes()] if terms.sensitivities else []
        return (*self._base, *further, *free)

    def solve(self, terms: FrictionTerms) -> _Solved:
        """Least squares of all parameters.

        Raises:
            IdentificationError: columns depend on each other.
        """
        kinds = self.kinds(terms)
        candidates = [Candidate(kind, terms.shape_of(kind, 0)) for kind in kinds]
        columns = np.concatenate([self._data.own, self._data.columns(candidates, self._load)], axis=1)
        scale = np.linalg.norm(columns, axis=0)
        if np.any(scale == 0.0) or np.linalg.cond(columns / scale) > 1e8:
            raise IdentificationError(
                f"the movements of {self._name} do not distinguish its friction terms", hint="sweep more speeds"
            )
        parameters = np.linalg.lstsq(columns / scale, self._data.torque, rcond=None)[0] / scale
        return _Solved(
            terms, columns, parameters, self._data.torque - columns @ parameters, self._data.own.shape[1], kinds
        )

    def search(self, base: FrictionTerms) -> FrictionSearch:
        """Choices among the candidates that the spans allow and some terms lack, beside these."""
        solved = self.solve(base)
        greatest = max(float(np.max(np.abs(period.velocity))) for period in self._data.periods)
        heat = TEMPERATURE_KINDS[: self.slope * (2 + self.curvature)]
        missing = {option.group for option in OPTIONS if base.option(option.group, 0) is None}
        kinds = {kind for option in OPTIONS if option.group in missing for kind in option.kinds}
        candidates = tuple(
            candidate
            for kind in CANDIDATE_KINDS
            if kind in kinds and (kind in heat or kind not in TEMPERATURE_KINDS)
            for candidate in term_candidates(kind, greatest, loads=self.loads, warmed=np.inf)
        )
        further = [self._data.columns(candidates, self._load)] if candidates else []
        stacked = np.concatenate([solved.columns, *further, self._data.torque[:, None]], axis=1)
        count = self._data.count
        fold = self._data.index * (FOLDS * SHARES_OF_A_FOLD) // count % FOLDS
        grams = np.array([stacked[fold == block].T @ stacked[fold == block] for block in range(FOLDS)])
        rows = np.bincount(fold, minlength=FOLDS).astype(np.float64)[:, None]
        width = solved.columns.shape[1]
        own: dict[str, int] = {kind: solved.own + place for place, kind in enumerate(solved.kinds)}
        share = independent_share(self._data.autocorrelation(solved.residual)) * count / len(self._data.index)
        return FrictionSearch(
            CandidateGrams((candidates,), (tuple(range(width)),), (grams,), rows, width),
            range(width),
            [own.get("viscous")],
            [own.get("coulomb")],
            [0],
            np.array([share]),
        )

    def chosen(self) -> tuple[FrictionTerms, tuple[FrictionStep, ...]]:
        """Terms by held-out error and F-test."""
        terms, steps = no_terms(1), []
        while True:
            search = self.search(terms)
            steps += search.choose(0, self._name)
            while search.revise(0):
                steps += search.choose(0, self._name)
            searched = search.terms(terms)
            if searched == terms:
                return terms, tuple(steps)
            terms = self._without_curvature(searched)  # with its shapes and load torque, others may count

    def _without_curvature(self, terms: FrictionTerms) -> FrictionTerms:
        """The terms settled, that of the temperature linear where its curvature is not significant."""
        # Terms were added one by one: beside all others, other shapes may fit better.
        ends = [self.settled(start)[0] for start in (terms, self._started(terms))]
        settled = min(ends, key=lambda end: float(end.residual @ end.residual))
        if not terms.asks("temperature_curvature", 0):
            return settled.terms
        values, covariance, kinds = self._estimated(settled)
        place = kinds.index("temperature_curvature")
        significant = abs(values[place]) > WITHIN_95_PERCENT * np.sqrt(covariance[place, place])
        return settled.terms if significant else settled.terms.with_kinds(0, (), ("temperature_curvature",))

    def given(self, section: Friction, text: str) -> tuple[FrictionTerms, tuple[FrictionStep, ...]]:
        """The terms of a text that the spans allow, free shapes from the best of a grid."""
        terms = friction_terms(chosen_friction(section, text), (self._name,))
        terms = terms if terms.kinds else no_terms(1)
        if not terms.loaded:
            self._notes.pop("load", None)
        heat = [kind for kind in TEMPERATURE_KINDS if terms.asks(kind, 0)]
        if not heat or (len(heat) < len(TEMPERATURE_KINDS) and self.slope):
            self._notes.pop("temperature", None)
        impossible = () if self.loads else LOAD_KINDS
        impossible += TEMPERATURE_KINDS[self.slope * (2 + self.curvature) :]
        return self._started(terms.with_kinds(0, (), impossible)), ()

    def _started(self, terms: FrictionTerms) -> FrictionTerms:
        """The terms with free shapes from the best of a grid, all shapes at once."""
        if not terms.shaped:
            return terms
        without = terms.without_free_shapes()
        search = self.search(without)
        search.start_shapes(0, [shape.name for shape, _ in terms.free_shapes()])
        return search.terms(without)

    def settled(self, terms: FrictionTerms) -> tuple[_Solved, bool]:
        """Load torque and shapes iterated until they do not change."""
        settled = settle(self, self.solve(terms))
        return settled.fit, settled.converged

    # What follows makes it a `FrictionProblem`.

    def terms(self, fit: _Solved) -> FrictionTerms:
        return fit.terms

    def value(self, fit: _Solved) -> Value:
        return fit.value

    def linearised(self, fit: _Solved) -> Value:
        return self.solve(replace(fit.terms, sensitivities=True)).value

    def fitted(self, fit: _Solved, terms: FrictionTerms) -> _Solved:
        return self.solve(terms)

    def no_worse(self, fit: _Solved, before: _Solved) -> bool:
        return bool(fit.residual @ fit.residual <= before.residual @ before.residual)

    def reloaded(self, fit: _Solved) -> tuple[Callable[[], _Solved], float]:
        before, self._load = self._load, self._data.load_torques(fit.parameters)
        size = max(float(np.max(np.abs(load))) for load in self._load)
        moves = [float(np.max(np.abs(a - b))) for a, b in zip(before, self._load, strict=True)]
        return lambda: self.solve(fit.terms), max(moves) / size

    def _estimated(self, solved: _Solved) -> tuple[FloatArray, FloatArray, tuple[str, ...]]:
        """Friction coefficients and estimated shapes (k,), their covariance (k, k), and their kinds."""
        linear = self.solve(replace(solved.terms, sensitivities=True)) if solved.terms.shaped else solved
        columns = linear.columns.copy()
        coefficient = solved.value("load", 0)
        if coefficient is not None:
            power = solved.terms.shape_of("load", 0)
            columns[:, : linear.own] += self._data.load_slopes(coefficient, power, self._load)
        length = block_length(self._data.autocorrelation(solved.residual), self._data.count)
        along_motion = _jackknife(columns, linear.residual, self._data.index // length)
        covariance = _jackknife(columns, linear.residual, self._data.position_blocks())
        variance = np.diag(covariance)
        ratio = np.divide(np.diag(along_motion), variance, out=np.ones(len(variance)), where=variance > 0.0)
        factor = np.sqrt(np.maximum(1.0, ratio))
        covariance = (covariance * np.outer(factor, factor))[linear.own :, linear.own :]
        values = solved.parameters[solved.own :].tolist()
        for index, kind in enumerate(linear.kinds[len(solved.kinds) :], len(solved.kinds)):
            coefficient = solved.value(SHAPED[kind].kind, 0)
            # The parameter is the coefficient times a change of the shape.
            covariance[index] /= coefficient or np.nan
            covariance[:, index] /= coefficient or np.nan
            values.append(solved.terms.shape_of(kind, 0))
        return np.array(values), covariance, linear.kinds

    def result(self, solved: _Solved, steps: tuple[FrictionStep, ...], settled: bool) -> JointExperiment:
        """Values with their covariance, spans, and points for plots."""
        values, covariance, kinds = self._estimated(solved)
        own = self._data.own @ solved.parameters[: solved.own]
        heat = [
            np.full_like(period.velocity, np.nan) if period.temperature is None else period.temperature
            for period in self._data.periods
        ]
        value = dict(zip(kinds, values.tolist(), strict=True))
        std = dict(zip(kinds, np.sqrt(np.diag(covariance)).tolist(), strict=True))
        fields = friction_fields(solved.terms, 0, value, value.get, std.get)
        places = [kinds.index(kind) for kind in TEMPERATURE_KINDS if kind in value]
        if places:
            beta, deviations = temperature_estimate(values[places], covariance[np.ix_(places, places)])
            fields["temperature"], fields["temperature_std"] = beta.tolist(), deviations.tolist()
        kelvin, velocity = self.temperature, self._data.sampled([period.velocity for period in self._data.periods])
        stored = JointFrictionExperiment(
            joint=self._name,
            **fields,
            temperature_term="full" if len(places) == 3 else "linear" if places else "none",
            kinds=list(kinds),
            values=values.tolist(),
            covariance=np.where(np.isfinite(covariance), covariance, np.inf).tolist(),
            sliding=self._sliding,
            speed_range=_span(np.abs(velocity)),
            temperature_range=None
            if kelvin is None
            else ValueRange(least=kelvin.least - ZERO_CELSIUS, greatest=kelvin.greatest - ZERO_CELSIUS),
            load_range=self.load_span,
            least_temperature_span=LEAST_TEMPERATURE_SPAN,
            least_load_span=self.least_load_span,
            rmse=float(np.sqrt(np.mean(solved.residual**2))),
            samples=len(solved.residual),
            periods=len(self._data.periods),
            settled=settled,
            notes=list(self._notes.values()),
        )
        points = [velocity, self._data.sampled(heat), self._data.sampled(self._load), self._data.torque - own]
        return JointExperiment(stored, solved.terms, steps, np.array(points))


def _jackknife(columns: FloatArray, residual: FloatArray, block: npt.NDArray[np.int64]) -> FloatArray:
    """Delete-block covariance (p, p) of a least-squares solution with columns (R, p); R blocks by their numbers."""
    sums = BlockSums.empty(int(block.max()) + 1, columns.shape[1])
    sums.add(block, columns.T, residual)
    return jackknife_covariance(tolerant_moves(sums, sums.gram.sum(axis=0)))


def _span(values: FloatArray) -> ValueRange:
    return ValueRange(least=float(values.min()), greatest=float(values.max()))
