"""The load as a body that can exist, on an arm whose links can exist.

Least squares over both runs once more, on the triangular factor behind the unconstrained estimate: the pseudo-inertias
of the arm's links and of the load are positive definite by a margin (`ident.estimators.feasible`). Their sum, the link
that carries the load, then is so too.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pydantic import Field

from drivers.core.arrays import FloatArray
from drivers.core.errors import IdentificationError
from drivers.core.text import percent_text
from ident.estimators.feasible.consistent import FeasibleFit, bounded_precision, cost_test, feasible_fit
from ident.estimators.feasible.interior_point import BoolArray
from ident.estimators.feasible.prior import can_exist, link_priors, uniform_ball
from ident.estimators.feasible.problem import build_problem, with_load
from ident.estimators.feasible.pseudo_inertia import INERTIA_ELEMENTS, Body, body_of
from ident.experiments.load.load_estimate import LoadEstimate, relative_error
from ident.experiments.run_pair import FREE, LOADED, RunPair
from ident.linear_algebra.triangular import triangular
from ident.model.load import FIRST_MOMENTS, KnownLoad, load_effect, moved_origin
from ident.model.parameters import INERTIAL, MASS
from ident.regression.estimate import Estimate
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT, SignificanceTest
from ident.regression.systematic_errors import gain_covariances
from ident.stored import Real, Stored

LEAST_MASS = 1e-3
"""[kg] of the assumed load where no mass was identified."""

LOAD_SIZE = len(INERTIAL)


class RunError(Stored):
    """Relative error ‖τ − Wx‖/‖τ‖ of the torque in a run."""

    run: str
    unconstrained: Real
    consistent: Real


class LinkBody(Body):
    """A link of the arm with the load, in the frame of its joint."""

    link: str


class ConsistentLoad(Body):
    """A load that can exist, on an arm whose links can exist, in the tool frame; σ includes noise and gains."""

    mass_std: Real = Field(description="[kg]; 0 where known, null where the data do not determine it")
    com_std: list[Real] = Field(description="[m]")
    inertia_std: dict[str, Real] = Field(description="[kg·m²]")
    determined: dict[str, float] = Field(
        description="share of each standard parameter that the data determine; the rest comes from the prior"
    )
    held: list[str] = Field(description="standard parameters held at known values")
    rounded: bool = Field(description="the known inertia is not that of a body and was estimated in its place")
    on_boundary: bool = Field(description="the condition that it can exist holds it")
    boundary_links: list[str] = Field(description="links that the condition holds")
    cost: SignificanceTest | None = Field(description="rise in the sum of squares over the unconstrained estimate")
    errors: list[RunError]
    links: list[LinkBody] = Field(description="the arm with the load: its last link carries it")

    @property
    def sentences(self) -> list[str]:
        """Return what it costs that load and links can exist."""
        errors = "; ".join(
            f"{error.run}: {percent_text(error.unconstrained)} unconstrained, "
            f"{percent_text(error.consistent)} consistent"
            for error in self.errors
        )
        sentences = [f"relative error of the torque: {errors}"]
        if self.cost is not None:
            verdict = "explains the runs as well" if self.cost.passed else "does not explain the runs as well"
            sentences.append(
                f"a physically consistent load on consistent links {verdict} as the unconstrained estimate (χ² = "
                f"{self.cost.statistic:.1f} with {self.cost.freedom} degrees of freedom, {self.cost.p_text})"
            )
        held = ["the load"] * self.on_boundary + self.boundary_links
        if held:
            sentences.append(f"on the boundary of physical consistency: {', '.join(held)}")
        return sentences


def consistent_load(pair: RunPair, load: LoadEstimate, known: KnownLoad | None) -> ConsistentLoad | None:
    """The consistent load that belongs to an unconstrained one; None where no minimum is reached.

    Args:
        pair: the runs.
        load: estimated without any knowledge of the load.
        known: what is held fixed; None where nothing is.

    Raises:
        RobotFileError: the file's `known` values are impossible, alone or together.
    """
    from scipy.linalg import block_diag

    base, robot_file = pair.base, pair.robot_file
    estimate = bounded_precision(load.estimate)
    of_arm = _of_arm(estimate, base.count)
    combinations = of_arm.combinations(base.projection)
    priors = link_priors(pair.model, robot_file, of_arm.root @ combinations, of_arm.root @ of_arm.values)
    prior, fixed, rounded = _prior(load, known)
    problem = with_load(
        build_problem(pair.model, robot_file, base, of_arm, priors), prior, fixed, robot_file.robot.prior
    )
    projection = block_diag(base.projection, load.columns.projection)
    try:
        # The same values, with deviations by gains of independent and of common errors.
        independent, common = (
            feasible_fit(
                problem, replace(estimate, covariance=estimate.covariance + of_gains), projection, robot_file.robot.name
            )
            for of_gains in gain_covariances(load.estimate_gain_moves)
        )
    except IdentificationError:
        return None
    fit = independent
    arm, own = fit.values[:-LOAD_SIZE], fit.values[-LOAD_SIZE:]
    names = pair.model.link_names
    links = arm[: LOAD_SIZE * len(names)].reshape(-1, LOAD_SIZE).copy()
    links[pair.model.tool_link] += moved_origin(np.array(robot_file.robot.workspace.tool)) @ own
    free_values = np.zeros(base.count + len(load.columns.names))
    free_values[list(estimate.active)] = estimate.values
    effect = load_effect(pair.model, base, robot_file.robot)
    body = body_of(own)
    deviations = np.maximum(*(_deviations(fitted, body, fixed) for fitted in (independent, common)))
    errors = zip(
        pair.runs,
        _errors(pair, free_values[: base.count], load.columns.effect @ free_values[base.count :]),
        _errors(pair, base.projection @ arm, effect @ own),
        strict=True,
    )
    parameters = [f"{symbol}_L" for symbol in INERTIAL]
    return ConsistentLoad(
        **dict(body),
        mass_std=float(deviations[MASS]),
        com_std=(deviations[list(FIRST_MOMENTS)] / own[MASS]).tolist(),
        inertia_std=dict(zip(INERTIA_ELEMENTS, deviations[:6].tolist(), strict=True)),
        determined=dict(zip(parameters, fit.determined[-LOAD_SIZE:].tolist(), strict=True)),
        held=[name for name, known_value in zip(parameters, fixed, strict=True) if known_value],
        rounded=rounded,
        on_boundary=len(names) in fit.boundary,
        boundary_links=[names[link] for link in fit.boundary if link < len(names)],
        cost=cost_test(fit, estimate),
        errors=[RunError(run=run.label, unconstrained=error, consistent=own_error) for run, error, own_error in errors],
        links=[LinkBody(link=name, **dict(body_of(link))) for name, link in zip(names, links, strict=True)],
    )


def _of_arm(estimate: Estimate, count: int) -> Estimate:
    """The estimate of the base parameters alone, that of the load left open."""
    of_arm = [place for place, column in enumerate(estimate.active) if column < count]
    of_load = [place for place, column in enumerate(estimate.active) if column >= count]
    root = triangular(estimate.root[:, [*of_load, *of_arm]])[len(of_load) :, len(of_load) :]
    active = tuple(estimate.active[place] for place in of_arm)
    return Estimate(
        active=active,
        values=estimate.values[of_arm],
        root=root,
        covariance=estimate.covariance[np.ix_(of_arm, of_arm)],
        absorbed=estimate.absorbed[of_arm, : count - len(active)],
        blocks=estimate.blocks,
    )


def _prior(load: LoadEstimate, known: KnownLoad | None) -> tuple[FloatArray, BoolArray, bool]:
    """A ball of uniform density, known parameters in place; which are held fixed; whether an inertia is not used."""
    fixed = np.zeros(LOAD_SIZE, dtype=np.bool_)
    if known is None:
        mass = float(load.standard[MASS])
        if not mass > 0:
            mass = WITHIN_95_PERCENT * float(load.standard_deviations(np.eye(LOAD_SIZE))[MASS])
        return uniform_ball(max(mass, LEAST_MASS), np.zeros(3)), fixed, False
    whole = known.inertia is not None and can_exist(known.mass, known.inertia)
    if whole:
        return known.values, ~fixed, False
    fixed[[i for i in known.known if i == MASS or i in FIRST_MOMENTS]] = True
    return uniform_ball(known.mass, np.array(known.com or np.zeros(3))), fixed, known.inertia is not None


def _deviations(fit: FeasibleFit, body: Body, fixed: BoolArray) -> FloatArray:
    """Deviations (10,) of inertia and first moments about the body's centre, and of its mass.

    About the centre of mass, to first order, the inertia does not depend on where the centre is.
    """
    to_centre = moved_origin(-np.array(body.com))
    open_ones = ~fixed & ~np.isfinite(fit.std[-LOAD_SIZE:])
    spread = np.linalg.norm(to_centre @ fit.spread[-LOAD_SIZE:], axis=1)
    return np.where(np.any(to_centre[:, open_ones] != 0, axis=1), np.nan, spread)


def _errors(pair: RunPair, parameters: FloatArray, change: FloatArray) -> tuple[float, float]:
    """Relative errors of the torque of both runs; base parameters (b,) of the free arm, and what the load adds."""
    free = relative_error(pair.runs[FREE].reduction, parameters)
    return free, relative_error(pair.runs[LOADED].reduction, parameters + change)
