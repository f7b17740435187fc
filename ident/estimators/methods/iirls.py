"""I-IRLS: robust least squares with nonlinear friction and load torque estimated along (AUBO Algorithm 1).

The two inner loops are those of `reweighting`; the third one changes the shapes of the friction, the fourth one the
load torque, by the gravity parameters just estimated (eq. 18): steps of `ident.friction.solver`. ID-IRLS (eq. 19)
estimates inertial and friction parameters in turn, each with the others as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import Annotated

from pydantic import Field

from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from drivers.core.text import percent_text
from ident.estimators.estimator import Estimation, EstimationLoop, Estimator, Setup
from ident.estimators.method import Method, within
from ident.estimators.methods.irls import IrlsOptions, RobustEstimator, estimation, reweighting
from ident.estimators.robust.friction_bounds import FrictionBounds, friction_bounds
from ident.estimators.robust.reweighting import Reweighting, RobustFit, Solve
from ident.estimators.robust.sensitivities import ShapeSystem
from ident.estimators.robust.weight_functions import HUBER_THRESHOLD, WeightFunction
from ident.friction.solver import SHAPE_TOLERANCE, Value, settle_nested, shape_step
from ident.friction.table import FRICTION_KINDS
from ident.friction.terms import FrictionTerms
from ident.model.base_parameters import gravity_of
from ident.model.joint_columns import own_column
from ident.model.regressor import RegressorKernel, load_change
from ident.ranges import FRICTION_SHARE
from ident.regression.least_squares import LeastSquares
from ident.regression.observation_matrix import Reduction
from ident.signals.prepared import Prepared, Step

MOST_SHAPE_ROUNDS = 15
MOST_LOAD_ROUNDS = 10

SHAPE_WEIGHTS = WeightFunction("huber", HUBER_THRESHOLD)
"""What the shapes are estimated with: by weights that reject, a wrong shape rejects what contradicts it."""

LOSS_TOLERANCE = 1e-9
"""By which the mean loss may grow, 1 being that of a fit's own noise."""

EVERY_LENGTH = 40
"""Lengths of a step that are tried: until the change of the shapes is below their tolerance."""


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
        outer = _OuterLoops(self, loops)
        settled = settle_nested(outer, loops.started(self.setup.kernel, plain), outer.settled_shapes, MOST_LOAD_ROUNDS)
        fit = settled.fit
        inner = estimation(fit, loops, "iirls")
        if self.bounded:
            inner = replace(inner, steps=(*inner.steps, self._bounds_step(fit)))
        converged = fit.settled and outer.shapes_settled and settled.converged
        solution = replace(inner.solution, parameters=fit.solution.parameters, settled=converged)
        return replace(inner, solution=solution, loops=(*inner.loops, *outer.loops_of(fit, settled.converged)))

    def solver(self, active: Sequence[int]) -> Solve:
        """The solver of IRLS within the bounds; decoupled, friction alone and then the others, once a pass."""
        together = super().solver(active)
        if not self.bounded:
            return together
        # The bounds follow the shapes and the load torque, which are those of the kernel.
        bounds = lru_cache(maxsize=1)(partial(friction_bounds, self.setup, share=self.largest_friction))
        if not self.decoupled:
            return lambda kernel, reduction, before: bounds(kernel).solution(reduction, active)
        friction = [column for column in active if column in friction_columns(self.setup)]
        others = [column for column in active if column not in friction]

        def solve(kernel: RegressorKernel, reduction: Reduction, before: FloatArray) -> LeastSquares:
            parameters = before.copy()
            for columns in (friction, others):
                parameters[columns] = bounds(kernel).alone(reduction, columns, parameters)
            return replace(together(kernel, reduction, before), parameters=parameters)

        return solve

    @property
    def bounded(self) -> bool:
        """Return whether the parameters are estimated within bounds."""
        terms = self.setup.kernel.model.terms
        further = terms.shaped or terms.loaded
        return self.decoupled or self.largest_friction is not None or (further and not self.consistent)

    def _bounds_step(self, fit: RobustFit) -> Step:
        largest = self.largest_friction
        reached = friction_bounds(self.setup, fit.kernel, largest).reached(fit.solution.parameters)
        names = ", ".join(self.setup.base.names[place] for place in reached) or "none"
        text = f"no negative term except the offset (AUBO eq. 16); at a bound: {names}"
        if largest is None:
            return Step("friction bounds", {}, text)
        text = f"each term at most {percent_text(largest)} of the joint's torque limit, {text}"
        return Step("friction bounds", {"largest_friction": largest}, text)


@dataclass
class _OuterLoops:
    """The third and the fourth loop as a `FrictionProblem`, and what they record."""

    estimator: FullFrictionEstimator  # whose loops
    inner: Reweighting  # the two inner ones
    # geometric mean of the joints' residual standard deviations after each round of the third loop [N·m]
    spreads: list[float] = field(default_factory=list)
    shapes: list[FrictionTerms] = field(default_factory=list)  # after each, the friction's terms
    # largest relative change of the load torque in each round of the fourth loop
    loads: list[float] = field(default_factory=list)
    shapes_settled: bool = True  # whether the third loop converged the last time

    def terms(self, fit: RobustFit) -> FrictionTerms:
        return fit.kernel.model.terms

    def value(self, fit: RobustFit) -> Value:
        def value(kind: str, motor: int) -> float | None:
            column = own_column(fit.kernel.model, fit.kernel.columns, kind, motor)
            return None if column is None else float(fit.solution.parameters[column])

        return value

    def linearised(self, fit: RobustFit) -> Value:
        system, held = ShapeSystem.at(self.inner, fit, SHAPE_WEIGHTS), set[int]()
        if self.estimator.bounded:
            held = set(self._bounds(fit).reached(fit.solution.parameters))
        parameters = system.together([column for column in self.inner.active if column not in held])
        return partial(system.value, parameters)

    def fitted(self, fit: RobustFit, terms: FrictionTerms) -> RobustFit:
        return self._iterated(fit, terms, fit.solution.parameters)

    def no_worse(self, fit: RobustFit, before: RobustFit) -> bool:
        # All equations at one Ω: the accepted ones' spread would also fall by rejecting more of them.
        losses = [of.loss(before.covariance, SHAPE_WEIGHTS) for of in (fit, before)]
        return losses[0] <= losses[1] + LOSS_TOLERANCE

    def reloaded(self, fit: RobustFit) -> tuple[Callable[[], RobustFit], float]:
        gravity = gravity_of(self.estimator.setup.base, fit.solution.parameters)
        terms = replace(self.terms(fit), load_torque=gravity)
        self.loads.append(load_change(fit.kernel.model, self.inner.runs, self.terms(fit), terms))
        return lambda: self.fitted(fit, terms), self.loads[-1]

    def settled_shapes(self, fit: RobustFit) -> RobustFit:
        """Shapes until they settle."""
        for _ in range(MOST_SHAPE_ROUNDS if self.terms(fit).shaped else 0):
            fit, change = shape_step(self, fit, EVERY_LENGTH)
            self.spreads.append(fit.spread)
            self.shapes.append(self.terms(fit))
            self.shapes_settled = change < SHAPE_TOLERANCE
            if self.shapes_settled:
                break
        return fit

    def _bounds(self, fit: RobustFit) -> FrictionBounds:
        return friction_bounds(self.estimator.setup, fit.kernel, self.estimator.largest_friction)

    def _iterated(self, fit: RobustFit, terms: FrictionTerms, start: FloatArray) -> RobustFit:
        kernel = RegressorKernel(replace(fit.kernel.model, terms=terms), fit.kernel.columns)
        return self.inner.iterated(kernel, start, fit.covariance)

    def loops_of(self, fit: RobustFit, load_settled: bool) -> tuple[EstimationLoop, ...]:
        """Third and fourth loop, and the shapes by joint (AUBO Figs. 10 and 11)."""
        loops = []
        if self.spreads:
            name = "friction, residual σ (mean over the joints)"
            loops.append(EstimationLoop(name, "N·m", tuple(self.spreads), self.shapes_settled))
        for shape, motor in self.terms(fit).free_shapes() if self.shapes else ():
            values = tuple(terms.shape(shape.name, motor) for terms in self.shapes)
            joint = fit.kernel.model.joint_names[motor]
            loops.append(EstimationLoop(shape.text, shape.unit, values, self.shapes_settled, joint))
        if self.loads:
            loops.append(EstimationLoop("load torque, relative change", "", tuple(self.loads), load_settled))
        return tuple(loops)


def friction_columns(setup: Setup) -> frozenset[int]:
    """Base columns of friction."""
    standard = setup.kernel.model.parameters
    return frozenset(
        place
        for place, column in enumerate(setup.kernel.columns)
        if standard[column].kind in FRICTION_KINDS
        or (standard[column].kind == "coupling" and standard[column].symbol != "Iac")
    )


@dataclass(frozen=True)
class IirlsOptions(IrlsOptions):
    """Options of I-IRLS."""

    decoupled: Annotated[bool, Field(description="estimate inertial and friction parameters in turn (ID-IRLS)")] = False
    largest_friction: Annotated[
        float | None,
        within(FRICTION_SHARE),
        Field(
            description="bounds of the friction (AUBO eq. 16): a term's largest share of the joint's torque limit; "
            "dissipative terms are then not negative; no bounds if absent"
        ),
    ] = None

    def __post_init__(self) -> None:
        if self.consistent and self.largest_friction is not None:
            raise UsageError(
                "consistent=true and largest_friction exclude each other",
                where="--method iirls",
                hint="consistent parameters exclude negative friction, too",
            )


def _estimator(options: IirlsOptions, setup: Setup) -> Estimator:
    return FullFrictionEstimator(
        setup, options.weights, options.consistent, options.decoupled, options.largest_friction
    )


METHOD = Method(
    "as irls; friction shapes and load torque are estimated as well, from the same weighted equations",
    "torque",
    IirlsOptions,
    _estimator,
)
