"""Physically consistent standard parameters that explain an estimate of base parameters best."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from daq.robot.loader import RobotFile
from daq.robot.prior import TOTAL_MASS, Known
from drivers.core.arrays import FloatArray
from drivers.core.errors import IdentificationError, RobotFileError
from ident.estimators.feasible.armature import Armature, armatures
from ident.estimators.feasible.interior_point import BoolArray, NewtonMinimum, minimise, strictly_inside
from ident.estimators.feasible.prior import apparent_mass, link_priors
from ident.estimators.feasible.problem import FeasibilityProblem, build_problem, offset_sizes
from ident.linear_algebra.independent_columns import DETERMINED, row_space
from ident.model.base_parameters import BaseParameters
from ident.model.dynamic_model import DynamicModel
from ident.model.parameters import LINK_SIZE, MASS
from ident.regression.estimate import Estimate
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT, SignificanceTest

ON_BOUNDARY = 0.05
"""A link lies on the boundary where the smallest eigenvalue of its pseudo-inertia, over its prior's, is below this."""

AT_LIMIT = 0.01
"""A range is hit where its slack, in units of the parameter, is below this."""

RESISTING = 0.05
"""Conditions that resist with more than this share of the greatest force cannot hold together."""

PRECISION = 1e6
"""Torques count as no more exact than this share of their size: noise-free data would leave the prior no digits."""

MOST_INFLATED = 10.0
"""Largest variance of a combination over its white one, over their median, that counts in the mean."""

DENIED, EASED = 1e-3, 0.5
"""The robot file's values and ranges are compared with the data where bodies with them explain the data with a p-value
below this; they are contradicted where the misfit without them is below this share."""

NAMED_SHARE = 0.25
"""Share of the largest deviation [σ] of a known value from the data below which another one is not named beside it."""


@dataclass(frozen=True)
class FeasibleFit:
    """Minimum of a problem; p parameters, a estimated values."""

    values: FloatArray  # (p,) in column order
    moves: FloatArray  # (p, a) their derivative by the estimated values
    spread: FloatArray  # (p, a) a root of their covariance: spread @ spread.T
    std: FloatArray  # (p,) standard deviations of what the data determine; nan for the rest
    determined: FloatArray  # (p,) share of each that the data determine; the rest comes from the prior
    misfit: float  # rise of the sum of squared residuals, each of unit variance, over that of the estimate
    left: FloatArray  # (a, a) share of a small change of the whitened values that conditions and prior do not follow
    boundary: tuple[int, ...]  # indices of the bodies that the conditions hold near the boundary
    limits_hit: tuple[str, ...]  # ranges of the file that are active
    steps: int  # Newton steps


@dataclass(frozen=True)
class ConsistentParameters(FeasibleFit):
    """Standard parameters of bodies that can exist."""

    known: BoolArray  # (p,) whether the robot file names its value
    base: FloatArray  # (b,) the base parameters of `values`
    base_covariance: FloatArray  # (b, b)
    base_moves: FloatArray  # (b, a) derivative of `base` by the estimated values
    sources: tuple[str, ...]  # (k,) where each link's prior comes from
    # whether noise explains the misfit where the truth is consistent; None where no variance is known
    cost: SignificanceTest | None
    # what the robot file says of links and joints, and the data deny: keys of the file, with what the data say
    contradicted: tuple[str, ...] = ()
    # (b,) base parameters without all that the file says of links and joints, where the data deny it
    without: FloatArray | None = None
    armatures: tuple[Armature, ...] = ()  # of motors whose inertia the measured torque does not carry
    apparent_mass: float | None = None  # of all links, as `apparent_mass` has it [kg]; None where the data show none


def consistent_parameters(
    model: DynamicModel, base: BaseParameters, estimate: Estimate, robot_file: RobotFile
) -> ConsistentParameters:
    """Least squares on the estimate's triangular factor, with positive links, inertias and friction.

    The sum of squares is that of the estimator, with its weights, so that it does not matter how long the recording
    was.

    Args:
        model: the arm.
        base: base parameters of the experiment.
        estimate: of them.
        robot_file: for `known`, `prior` and the URDF's bodies.

    Raises:
        RobotFileError: the file's `known` values are impossible, alone or together.
        IdentificationError: no minimum was reached.
    """
    estimate = bounded_precision(estimate)
    system = estimate.root @ estimate.combinations(base.projection)
    target = estimate.root @ estimate.values
    # What a lift carries shows how heavy the links are, too.
    offsets = offset_sizes(model, base, estimate)
    small = np.zeros((len(offsets), system.shape[1]))
    small[range(len(offsets)), list(offsets)] = 1.0 / np.array(list(offsets.values()))
    system, target = np.vstack([system, small]), np.append(target, np.zeros(len(offsets)))
    priors = link_priors(model, robot_file, system, target)
    problem = build_problem(model, robot_file, base, estimate, priors)
    fit = feasible_fit(problem, estimate, base.projection, robot_file.robot.name)
    of_base = base.projection @ fit.spread
    cost = cost_test(fit, estimate)
    contradicted: tuple[str, ...] = ()
    without: FloatArray | None = None
    if cost is not None and cost.p_value < DENIED:
        contradicted, without = _contradicted(model, base, estimate, robot_file, fit)
    return ConsistentParameters(
        **vars(fit),
        known=~problem.free,
        base=base.projection @ fit.values,
        base_covariance=of_base @ of_base.T,
        base_moves=base.projection @ fit.moves,
        sources=priors.sources,
        cost=cost,
        contradicted=contradicted,
        without=without,
        armatures=armatures(model, robot_file.robot, range(len(fit.values)), fit.values),
        apparent_mass=apparent_mass(model, priors.links, system, target),
    )


def _contradicted(
    model: DynamicModel, base: BaseParameters, estimate: Estimate, robot_file: RobotFile, fit: FeasibleFit
) -> tuple[tuple[str, ...], FloatArray | None]:
    """Return what of the file makes the sum of squares more than twice as large, and the base parameters without it."""
    robot = robot_file.robot
    links = {
        name: link.model_copy(update={"com_box": None, "com_hull": None}) for name, link in robot.prior.links.items()
    }
    prior = robot.prior.model_copy(update={"links": links})
    if not robot.known and prior == robot.prior:
        return (), None
    without = robot_file.model_copy(update={"robot": robot.model_copy(update={"known": {}, "prior": prior})})
    try:
        free = consistent_parameters(model, base, estimate, without)
    except IdentificationError:
        return (), None
    if free.misfit > EASED * fit.misfit:
        return (), None
    names = [parameter.name for parameter in model.parameters]
    values = dict(zip(names, zip(free.values, free.std, strict=True), strict=True))
    numbers = {
        name: number.value for name, number in robot.known.items() if name in values and number.value is not None
    }
    # A wrong value makes right ones look wrong, too, but less so.
    beyond = {n: abs(values[n][0] - known) / values[n][1] for n, known in numbers.items() if values[n][1] > 0.0}
    seen = [n for n, far in beyond.items() if far > max(WITHIN_95_PERCENT, NAMED_SHARE * max(beyond.values()))]
    stated = [f"known.{name}" for name in seen or (() if fit.limits_hit else numbers)]
    total = robot.known.get(TOTAL_MASS)
    if total is not None and total.value is not None and not seen:
        stated.append(f"known.{TOTAL_MASS}")
    keys = dict.fromkeys([*stated, *fit.limits_hit])
    return tuple(f"{key}{_of_data(key, robot.known, values, free, model)}" for key in keys), free.base


def _of_data(
    key: str,
    known: Mapping[str, Known],
    values: Mapping[str, tuple[float, float]],
    free: ConsistentParameters,
    model: DynamicModel,
) -> str:
    """Return what the file and the data say of a key, in words: behind the key."""
    name = key.split(".")[1]
    if name in known:
        entry = known[name]
        limits = [
            f"{word} {limit:.4g}" for word, limit in (("min", entry.min), ("max", entry.max)) if limit is not None
        ]
        text = ", ".join(limits) if entry.value is None else f"= {entry.value:.4g}"
        if name in values and np.isfinite(values[name][1]):
            value, std = values[name]
            return f" {text} (the data say {value:.4g} ± {WITHIN_95_PERCENT * std:.2g})"
        mass = free.apparent_mass
        return f" {text} (the data say about {mass:.3g} kg)" if name == TOTAL_MASS and mass is not None else f" {text}"
    if name != "links":
        return ""
    link = LINK_SIZE * model.link_names.index(key.split(".")[2])
    centre = free.values[link + 6 : link + 9] / free.values[link + MASS]
    return f" (without it the centre of mass is at {', '.join(f'{coordinate:.3g}' for coordinate in centre)} m)"


def bounded_precision(estimate: Estimate) -> Estimate:
    """The estimate, its torques no more exact than autocorrelated residuals leave them, or `PRECISION` of their size.

    The factor behind an estimate counts every residual as independent; its covariance, corrected by the jackknife, says
    what they are worth. Otherwise a prior would fade as the sampling rate grows. Friction that changes between runs
    says nothing of the torques' precision: all bodies would follow their prior for it. Nor does a combination that one
    block of the jackknife shows alone, whose variance has no bound.
    """
    covariance = estimate.covariance if estimate.within is None else estimate.within
    covariance = np.where(np.isfinite(covariance), covariance, 0.0)
    inflations = np.einsum("ij,jk,ik->i", estimate.root, covariance, estimate.root)
    inflation = (
        float(np.mean(np.minimum(inflations, MOST_INFLATED * np.median(inflations)))) if len(inflations) else 1.0
    )
    root = estimate.root / np.sqrt(max(1.0, inflation))
    size = float(np.linalg.norm(root @ estimate.values))
    return replace(estimate, root=root * min(1.0, PRECISION / max(size, 1e-300)))


def feasible_fit(problem: FeasibilityProblem, estimate: Estimate, projection: FloatArray, where: str) -> FeasibleFit:
    """Least squares on an estimate's triangular factor under the conditions of a problem.

    Args:
        problem: with p variables.
        estimate: of b combinations of them, of `bounded_precision`.
        projection: (b, p) these combinations.
        where: the robot's name in messages.

    Raises:
        RobotFileError: the conditions contradict each other.
        IdentificationError: no minimum was reached.
    """
    from scipy.linalg import solve_triangular

    system, target = estimate.root @ estimate.combinations(projection), estimate.root @ estimate.values
    start, forces = strictly_inside(problem.conditions, problem.start, problem.free)
    if np.any(forces > 0):
        resisting = [n for n, force in zip(problem.names, forces, strict=True) if force > RESISTING * forces.max()]
        raise RobotFileError(
            f"no body satisfies all of: {', '.join(dict.fromkeys(resisting))}",
            where=where,
            hint="widen a range of 'known' or 'prior'",
        )
    scaled = system * problem.scale
    minimum = minimise(
        np.vstack([scaled, problem.rows]),
        np.concatenate([target, problem.values]),
        problem.conditions,
        start,
        problem.free,
    )
    values = problem.scale * minimum.y
    moves = problem.scale[:, None] * _moves(minimum, scaled, estimate, problem.free)
    # The minimum is a smooth function of the estimate, so its jackknife covariance carries over (delta method).
    spread = moves @ _root(estimate.covariance)
    determined = np.zeros(len(values))
    determined[problem.free] = row_space(scaled[:, problem.free]).shares
    misfit = system @ values - target
    followed = solve_triangular(minimum.root, scaled[:, np.flatnonzero(problem.free)].T, trans="T")
    return FeasibleFit(
        values=values,
        moves=moves,
        spread=spread,
        # The error of what a parameter is confounded with comes from the prior and has no σ.
        std=np.where(determined >= DETERMINED, np.linalg.norm(spread, axis=1), np.nan),
        determined=determined,
        misfit=float(misfit @ misfit),
        left=np.eye(len(system)) - followed.T @ followed,
        boundary=_boundary(problem, minimum),
        limits_hit=_limits_hit(problem, minimum),
        steps=minimum.steps,
    )


def cost_test(fit: FeasibleFit, estimate: Estimate) -> SignificanceTest | None:
    """Test whether the rise in the sum of squares is what noise makes of it, given the conditions that are active.

    Where a polyhedron's face is active, the rise is a chi-square variable with as many degrees of freedom as the face
    takes from the parameters (Bartholomew 1961). Here it is a weighted sum of squares, its mean and variance those of
    the estimate's covariance, autocorrelation included, in the directions that conditions and prior do not follow
    (Satterthwaite 1946); the variance comes from the blocks of the jackknife.
    """
    from scipy.special import fdtrc

    whitened = fit.left @ estimate.root @ np.where(np.isfinite(estimate.covariance), estimate.covariance, 0.0)
    spread = whitened @ estimate.root.T @ fit.left.T
    mean, square = float(np.trace(spread)), float(np.sum(spread * spread.T))
    if not (mean > 0 and square > 0 and estimate.blocks > 1):
        return None
    freedom = mean**2 / square
    statistic = fit.misfit * freedom / mean
    return SignificanceTest(
        statistic, max(1, round(freedom)), float(fdtrc(freedom, estimate.blocks - 1, fit.misfit / mean))
    )


def found_consistent(
    model: DynamicModel, base: BaseParameters, estimate: Estimate, robot_file: RobotFile
) -> ConsistentParameters | None:
    """The same; None where no minimum is reached, which must not cost the rest of a result.

    Raises:
        RobotFileError: the file's `known` values are impossible, alone or together.
    """
    try:
        return consistent_parameters(model, base, estimate, robot_file)
    except IdentificationError:
        return None


def _boundary(problem: FeasibilityProblem, minimum: NewtonMinimum) -> tuple[int, ...]:
    matrices = problem.conditions.matrices(minimum.y)
    prior = problem.conditions.matrices(problem.start)
    relative = np.linalg.eigvals(np.linalg.solve(prior, matrices)).real.min(axis=1)
    return tuple(int(link) for link in np.flatnonzero(relative < ON_BOUNDARY))


def _limits_hit(problem: FeasibilityProblem, minimum: NewtonMinimum) -> tuple[str, ...]:
    near = problem.ranges & (problem.conditions.slacks(minimum.y) < AT_LIMIT)
    names = problem.names[len(problem.conditions.least) :]
    return tuple(dict.fromkeys(name for name, hit in zip(names, near, strict=True) if hit))


def _moves(minimum: NewtonMinimum, scaled: FloatArray, estimate: Estimate, free: BoolArray) -> FloatArray:
    """(p, a) derivative of the scaled parameters by the estimated values."""
    from scipy.linalg import solve_triangular

    moves = np.zeros((scaled.shape[1], len(estimate.values)))
    halfway = solve_triangular(minimum.root, scaled[:, np.flatnonzero(free)].T @ estimate.root, trans="T")
    moves[np.flatnonzero(free)] = solve_triangular(minimum.root, halfway)
    return moves


def _root(covariance: FloatArray) -> FloatArray:
    """(a, a) root of a covariance; variances that are not known count as 0."""
    finite = np.where(np.isfinite(covariance), covariance, 0.0)
    values, vectors = np.linalg.eigh(0.5 * (finite + finite.T))
    return np.asarray(vectors * np.sqrt(np.clip(values, 0.0, None)))
