"""Estimates by search: a population in place of a solution, on the same cost as least squares.

The cost is quadratic in the base parameters, so least squares is its exact optimum, and what the search leaves is
known: the gap in cost, and the difference of each parameter in its standard deviations.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.text import percent_text
from ident.estimators.estimator import Estimation, EstimationLoop, Setup
from ident.estimators.swarm.minimisation import Minimum, Optimiser, SearchBox, SearchBudget, minimise
from ident.estimators.swarm.physical import QuadraticCost
from ident.estimators.torque_estimator import TorqueEstimator
from ident.linear_algebra.triangular import triangular
from ident.regression.least_squares import LeastSquares
from ident.regression.observation_matrix import JointFactor, Reduction
from ident.signals.prepared import Prepared, Step

SETTLED_SHARE = 1e-3
"""A search has settled where its last tenth, of 10 generations at least, lowered the cost by less than this share."""

SHOWN = 500
"""Generations whose cost is stored at most."""

ENDED = {"generations": "", "time": " (time limit)", "interrupted": " (Ctrl-C)", "optimiser": " (its own criterion)"}


def no_penalty(points: FloatArray) -> FloatArray:
    """0 (P,) everywhere."""
    return np.zeros(len(points))


@dataclass(frozen=True, eq=False)
class Space:
    """What is searched."""

    box: SearchBox  # of the variables (d)
    base: Callable[[FloatArray], FloatArray]  # active base parameters (P, a) of a population (P, d)
    penalty: Callable[[FloatArray], FloatArray] = no_penalty  # (P,) added to the cost ‖W·x − τ‖
    # after the search, from the best point (d,) and the standard deviation of a weighted equation: for the list of
    # steps
    steps: Callable[[FloatArray, float], tuple[Step, ...]] = lambda point, deviation: ()


@dataclass(frozen=True)
class SearchEstimator(TorqueEstimator):
    """A search of the torque equations' cost, weighted as the least squares that it starts from."""

    space: Callable[[LeastSquares, QuadraticCost], Space]  # of the search, from the exact optimum and its cost
    optimiser: Optimiser  # with its settings
    budget: SearchBudget  # how long
    seed: int  # of the random numbers

    def estimate(self, runs: Sequence[Prepared], plain: Reduction, active: Sequence[int]) -> Estimation:
        """The best point of the search; error bars and essential model are those of least squares about it.

        Raises:
            IdentificationError: least squares has no solution, or not one cost was a number.
        """
        exact = self.solve(plain, active)
        cost = QuadraticCost.of_reduction(plain, active, exact.weights)
        space = self.space(exact, cost)

        def penalised(points: FloatArray) -> FloatArray:
            return cost(space.base(points)) + space.penalty(points)

        minimum = minimise(self.optimiser, penalised, space.box, self.budget, self.seed)
        parameters = np.zeros(plain.column_count)
        parameters[list(active)] = space.base(minimum.point[None, :])[0]
        reduction = centred_reduction(plain, parameters)
        deviation = float(np.sqrt(exact.residual_sum / (exact.rows - len(active))))
        return Estimation(
            self.setup.kernel,
            reduction,
            self.solve(reduction, active),
            loops=(_loop(minimum),),
            steps=(
                self._step(exact, parameters, cost.cost(parameters[list(active)]), minimum, space.box),
                *space.steps(minimum.point, deviation),
            ),
            optimum=exact,
        )

    def _step(self, exact: LeastSquares, parameters: FloatArray, cost: float, minimum: Minimum, box: SearchBox) -> Step:
        """Return what the search found, beside the exact optimum."""
        above = cost / max(float(np.sqrt(exact.residual_sum)), np.finfo(float).tiny) - 1.0
        used = list(exact.active)
        distance = np.abs(parameters - exact.parameters)[used] / exact.std[used]
        worst = int(np.argmax(distance))
        name = self.setup.base.names[used[worst]]
        edges = box.at_bound(minimum.point)
        figures = {
            "generations": minimum.generations,
            "evaluations": int(minimum.evaluations[-1]),
            "undefined_costs": minimum.undefined,
            "cost_above_optimum": above,
            "largest_difference": float(distance[worst]),
            "at_bounds": len(edges),
        }
        text = (
            f"{minimum.generations} generations{ENDED[minimum.ended]}, {int(minimum.evaluations[-1])} costs: "
            f"{percent_text(above, 3)} above the exact optimum, which is least squares; largest difference from it "
            f"{distance[worst]:.3g} σ of white residuals ({name})"
        )
        if edges:
            text += f"; {len(edges)} of {box.size} variables at a bound of the search box"
        if minimum.undefined:
            text += f"; {minimum.undefined} costs were not numbers"
        return Step("search", figures, "; ".join([text, *minimum.remarks]))


def base_space(share: float, setup: Setup) -> Callable[[LeastSquares, QuadraticCost], Space]:
    """The base parameters within a share of the absolute least-squares solution (ROCR6: 10 %)."""

    def space(exact: LeastSquares, cost: QuadraticCost) -> Space:
        names = [setup.base.names[column] for column in exact.active]
        return Space(SearchBox.around(exact.parameters[list(exact.active)], share, names), lambda points: points)

    return space


def centred_reduction(plain: Reduction, parameters: FloatArray) -> Reduction:
    """A system with the same columns that given parameters (b,) minimise, with the same residuals there."""
    joints = []
    sums = plain.residual_sums(parameters)
    for joint, residual in zip(plain.joints, sums, strict=True):
        width = len(joint.columns)
        columns = joint.factor[:, :width]
        rows = np.column_stack([columns, columns @ parameters[list(joint.columns)]])
        last = np.zeros((1, width + 1))
        last[0, width] = np.sqrt(residual)
        factor = triangular(np.vstack([rows, last])) if joint.rows else joint.factor
        joints.append(JointFactor(joint.columns, factor, joint.rows))
    return replace(plain, joints=tuple(joints))


def _loop(minimum: Minimum) -> EstimationLoop:
    """Convergence, for result and report: every generation of a short search, some of a long one."""
    count = len(minimum.history)
    shown = np.unique(np.linspace(0, count - 1, min(count, SHOWN)).round().astype(int))
    name = "cost of the best point ‖W·x − τ‖"
    if count > SHOWN:
        name += f", {SHOWN} of {count} generations"
    return EstimationLoop(name, "", tuple(minimum.history[shown].tolist()), _settled(minimum))


def _settled(minimum: Minimum) -> bool:
    tenth = max(10, len(minimum.history) // 10)
    return (
        bool(minimum.history[-1 - tenth] <= (1.0 + SETTLED_SHARE) * minimum.cost)
        if len(minimum.history) > tenth
        else False
    )
