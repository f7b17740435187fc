"""I-IRLS: robust least squares with nonlinear friction and load torque estimated along (AUBO Algorithm 1).

The two inner loops are those of `reweighting`; the third one changes the shapes of the friction, the fourth one the
load torque, by the gravity parameters just estimated (eq. 18). ID-IRLS (eq. 19) estimates inertial and friction
parameters in turn, each with the others as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.text import percent_text
from ident.estimators.estimator import Estimation, Loop, Setup
from ident.estimators.friction_steps import (
    LOAD_TOLERANCE,
    SHAPE_TOLERANCE,
    SHORTER,
    braking,
    gravity_of,
    load_change,
    moved_shapes,
    own_column,
    shape_change,
)
from ident.estimators.robust.friction_bounds import friction_bounds
from ident.estimators.robust.irls import RobustEstimator, estimation, reweighting
from ident.estimators.robust.reweighting import PARAMETER_TOLERANCE, Reweighting, RobustFit, Solve
from ident.estimators.robust.sensitivities import ShapeSystem
from ident.model.dynamic_model import DynamicModel
from ident.model.friction_terms import FrictionTerms
from ident.model.parameters import FRICTION_KINDS
from ident.model.regressor import RegressorKernel
from ident.regression.least_squares import LeastSquares
from ident.regression.observation_matrix import Reduction
from ident.signals.prepared import Prepared, Step

MOST_SHAPE_ROUNDS = 15
MOST_DECOUPLED_ROUNDS = 40
MOST_LOAD_ROUNDS = 10


@dataclass
class _Rounds:
    """What the outer loops record.

    Attributes:
        spreads: geometric mean of the joints' residual standard deviations after each round of the third loop [N·m].
        shapes: after each, the friction's terms.
        loads: largest relative change of the load torque in each round of the fourth loop.
        settled: whether the third and the fourth loop converged.
    """

    spreads: list[float] = field(default_factory=list)
    shapes: list[FrictionTerms] = field(default_factory=list)
    loads: list[float] = field(default_factory=list)
    settled: tuple[bool, bool] = (True, True)


@dataclass(frozen=True)
class FullFrictionEstimator(RobustEstimator):
    """I-IRLS on the joints' torque equations.

    Attributes:
        decoupled: whether inertial and friction parameters are estimated in turn.
        largest_friction: a term's largest share of the joint's torque limit (eq. 16; `friction_bounds`); None for no
            upper bounds. Without them friction with a shape or a load term, which could trade signs with the plain
            terms, is not negative, and plain friction is free, so that a wrong sign of the data shows.
    """

    decoupled: bool
    largest_friction: float | None = None

    def estimate(self, runs: Sequence[Prepared], plain: Reduction, active: Sequence[int]) -> Estimation:
        """Iterate all four loops from weighted least squares."""
        loops = reweighting(self.setup, self.weights, runs, plain, active, self.solver(active))
        fit, rounds = loops.started(self.setup.kernel, plain), _Rounds()
        fit = self._third_loop(loops, fit, rounds)
        terms = fit.kernel.model.terms
        if terms is not None and terms.loaded:
            fit = self._fourth_loop(loops, fit, rounds)
        inner = estimation(fit, loops, "iirls")
        if self._bounded:
            inner = replace(inner, steps=(*inner.steps, self._bounds_step(fit)))
        solution = replace(
            inner.solution, parameters=fit.solution.parameters, settled=fit.settled and all(rounds.settled)
        )
        return replace(inner, solution=solution, loops=(*inner.loops, *_outer_loops(rounds, fit.kernel.model)))

    def solver(self, active: Sequence[int]) -> Solve:
        """As for IRLS, within the bounds; decoupled, the parameters that are no friction, friction as it was."""
        together = super().solver(active)
        if self._bounded and not self.decoupled:
            # The bounds follow the shapes and the load torque, which are those of the kernel.
            bounds = lru_cache(maxsize=1)(partial(friction_bounds, self.setup, share=self.largest_friction))
            return lambda kernel, reduction, before: bounds(kernel).solution(reduction, active)
        if not self.decoupled:
            return together
        others = [column for column in active if column not in friction_columns(self.setup)]

        def solve(kernel: RegressorKernel, reduction: Reduction, before: FloatArray) -> LeastSquares:
            solution = together(kernel, reduction, before)
            factor = reduction.joints[0].factor
            parameters = before.copy()
            parameters[others] = 0.0
            target = factor[:, -1] - factor[:, :-1] @ parameters
            lengths = np.linalg.norm(factor[:, others], axis=0)
            parameters[others] = np.linalg.lstsq(factor[:, others] / lengths, target, rcond=None)[0] / lengths
            return replace(solution, parameters=parameters)

        return solve

    @property
    def _bounded(self) -> bool:
        terms = self.setup.kernel.model.terms
        further = terms is not None and (terms.shaped or terms.loaded)
        return self.largest_friction is not None or (further and not self.consistent and not self.decoupled)

    def _bounds_step(self, fit: RobustFit) -> Step:
        largest = self.largest_friction
        reached = friction_bounds(self.setup, fit.kernel, largest).reached(fit.solution.parameters)
        names = ", ".join(self.setup.base.names[place] for place in reached) or "none"
        text = f"no term negative but the offset (AUBO eq. 16); at a bound: {names}"
        if largest is None:
            return Step("friction bounds", {}, text)
        text = f"each term at most {percent_text(largest)} of the joint's torque limit, {text}"
        return Step("friction bounds", {"largest_friction": largest}, text)

    def _third_loop(self, loops: Reweighting, fit: RobustFit, rounds: _Rounds) -> RobustFit:
        """Shapes, and decoupled all friction, until they settle."""
        terms = fit.kernel.model.terms
        shaped = terms is not None and terms.shaped
        if not shaped and not self.decoupled:
            return fit
        settled = False
        for _ in range(MOST_DECOUPLED_ROUNDS if self.decoupled else MOST_SHAPE_ROUNDS):
            before = fit
            fit, change = self._round(loops, fit)
            rounds.spreads.append(fit.spread)
            if shaped:
                rounds.shapes.append(_terms(fit))
            step = np.abs(fit.solution.parameters - before.solution.parameters)[list(loops.active)]
            relative = float(np.max(step / np.sqrt(np.diag(fit.solution.covariance)), initial=0.0))
            settled = change < SHAPE_TOLERANCE and (not self.decoupled or relative < PARAMETER_TOLERANCE)
            if settled:
                break
        rounds.settled = settled, rounds.settled[1]
        return fit

    def _round(self, loops: Reweighting, fit: RobustFit) -> tuple[RobustFit, float]:
        """One step of the shapes, shortened until the fit is no worse; their largest relative change."""
        if self.decoupled:
            return self._decoupled_round(loops, fit)
        system = ShapeSystem.at(loops, fit)
        held = set[int]()
        if self._bounded:
            held = set(friction_bounds(self.setup, fit.kernel, self.largest_friction).reached(fit.solution.parameters))
        parameters = system.together([column for column in loops.active if column not in held])
        share = 1.0
        while True:
            moved = moved_shapes(_terms(fit), partial(system.value, parameters), share)
            change = shape_change(_terms(fit), moved)
            if change < SHAPE_TOLERANCE:
                return fit, change
            candidate = loops.iterated(_reshaped(fit.kernel, moved), fit.solution.parameters, fit.covariance)
            if candidate.spread <= fit.spread * (1.0 + 1e-9) and (_brakes(candidate) or not _brakes(fit)):
                return candidate, change
            share *= SHORTER

    def _decoupled_round(self, loops: Reweighting, fit: RobustFit) -> tuple[RobustFit, float]:
        """All friction by the torque that the other parameters leave (eq. 15 and 16), then these."""
        friction = [column for column in loops.active if column in friction_columns(self.setup)]
        system = ShapeSystem.at(loops, fit)
        bounds = None
        if self.largest_friction is not None:
            bounds = friction_bounds(self.setup, fit.kernel, self.largest_friction)
        parameters = system.friction_alone(friction, fit.solution.parameters, bounds)
        start = parameters[: len(fit.kernel.columns)]
        terms = fit.kernel.model.terms
        if terms is None or not terms.shaped:
            return loops.iterated(fit.kernel, start, fit.covariance), 0.0
        moved = moved_shapes(terms, partial(system.value, parameters), 1.0)
        return loops.iterated(_reshaped(fit.kernel, moved), start, fit.covariance), shape_change(terms, moved)

    def _fourth_loop(self, loops: Reweighting, fit: RobustFit, rounds: _Rounds) -> RobustFit:
        """Load torque from the gravity parameters, until it settles."""
        for _ in range(MOST_LOAD_ROUNDS):
            terms = replace(_terms(fit), load_torque=gravity_of(self.setup.base, fit.solution.parameters))
            rounds.loads.append(load_change(fit.kernel.model, loops.runs, _terms(fit), terms))
            if rounds.loads[-1] < LOAD_TOLERANCE:
                return fit
            fit = loops.iterated(_reshaped(fit.kernel, terms), fit.solution.parameters, fit.covariance)
            fit = self._third_loop(loops, fit, rounds)
        rounds.settled = rounds.settled[0], False
        return fit


def friction_columns(setup: Setup) -> frozenset[int]:
    """Base columns of friction."""
    standard = setup.kernel.model.parameters
    return frozenset(
        place
        for place, column in enumerate(setup.kernel.columns)
        if standard[column].kind in FRICTION_KINDS
        or (standard[column].kind == "coupling" and standard[column].symbol != "Iac")
    )


def _terms(fit: RobustFit) -> FrictionTerms:
    terms = fit.kernel.model.terms
    assert terms is not None
    return terms


def _brakes(fit: RobustFit) -> bool:
    """Whether friction with an estimated exponent brakes."""

    def value(kind: str, motor: int) -> float | None:
        column = own_column(fit.kernel.model, fit.kernel.columns, kind, motor)
        return None if column is None else float(fit.solution.parameters[column])

    return braking(_terms(fit), value)


def _reshaped(kernel: RegressorKernel, terms: FrictionTerms) -> RegressorKernel:
    return RegressorKernel(replace(kernel.model, terms=terms), kernel.columns)


def _outer_loops(rounds: _Rounds, model: DynamicModel) -> tuple[Loop, ...]:
    """Third and fourth loop, and the shapes by joint (AUBO Figs. 10 and 11)."""
    found = []
    if rounds.spreads:
        found.append(
            Loop("friction, residual σ (mean over the joints)", "N·m", tuple(rounds.spreads), rounds.settled[0])
        )
    terms = model.terms
    for name, unit, attribute, free in (
        ("exponent α", "", "exponent", "free_exponent"),
        ("Stribeck velocity", "rad/s", "stribeck_velocity", "free_stribeck_velocity"),
    ):
        for motor, joint in enumerate(model.joint_names):
            if terms is not None and getattr(terms, free)[motor] and rounds.shapes:
                values = tuple(getattr(shape, attribute)[motor] for shape in rounds.shapes)
                found.append(Loop(name, unit, values, rounds.settled[0], joint))
    if rounds.loads:
        found.append(Loop("load torque, relative change", "", tuple(rounds.loads), rounds.settled[1]))
    return tuple(found)
