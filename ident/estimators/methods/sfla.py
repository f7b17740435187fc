"""Shuffled frog leaping over the links' physical parameters (UP6)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from drivers.core.arrays import FloatArray
from ident.estimators.estimator import Estimator, Setup
from ident.estimators.feasible.prior import link_priors
from ident.estimators.method import Method, within
from ident.estimators.search_estimator import SearchEstimator, Space, no_penalty
from ident.estimators.swarm.frog_leaping import FrogLeaping
from ident.estimators.swarm.minimisation import SearchBox, SearchBudget
from ident.estimators.swarm.physical import (
    BODY_SIZE,
    FeasibilityPenalty,
    ParameterIdentifiability,
    PhysicalCost,
    PhysicalParameters,
    QuadraticCost,
    identifiability,
    physical_names,
    physical_values,
)
from ident.friction.table import TERM
from ident.ranges import BOX_SHARE, GENERATIONS, SEARCH_TIME, SEED
from ident.regression.least_squares import LeastSquares, weighted_least_squares
from ident.signals.prepared import Step

MASSES = (0.05, 3.0)
"""Box about the prior's mass and moments of inertia. A link may always weigh three times the arm's mean link."""

REACH = 2.0
"""Radii of gyration by which a centre of mass may be off; half of the arm's longest link where that is more."""

PRODUCTS = 0.5
"""Largest product of inertia over the geometric mean of its two moments of inertia."""

IMPOSSIBLE = 1.0
"""Penalty, over the cost of no model, of a link whose pseudo-inertia is as negative as its prior's is positive."""

LEAST_PRIOR = 1e-3
"""Least share of the prior's mass and moments of inertia, whatever the factor of the box."""

POSITIVE = (0, 4, 7, 9)
"""Places of mass and moments of inertia among a body's physical parameters."""

JOINTS = 2.0
"""Largest parameter of a joint's own, over the size of its least-squares estimate."""


def physical_space(setup: Setup, feasible: bool, share: float = 1.0) -> Callable[[LeastSquares, QuadraticCost], Space]:
    """Mass, centre of mass and inertia of each link, and joint parameters, as far as they act on the torque.

    Links have a box about their prior (robot file, URDF, or a bar of the density that fits best); joint parameters from
    0, or from the negative where they have a sign, to twice the size of their least-squares estimate.

    Args:
        setup: the data.
        feasible: add to the cost what makes a link impossible, `IMPOSSIBLE` times its violation.
        share: factor of every range about the prior; masses and moments of inertia stay above `LEAST_PRIOR` of
            the prior's.
    """
    model, projection = setup.kernel.model, setup.base.projection
    parameters, links = model.parameters, len(model.joints)

    def space(exact: LeastSquares, cost: QuadraticCost) -> Space:
        of_active = projection[list(exact.active)]
        priors = link_priors(model, setup.robot_file, cost.root @ of_active, cost.target)
        standard = np.concatenate([priors.links.ravel(), np.zeros(len(parameters) - BODY_SIZE * links)])
        reference = physical_values(model, standard)
        lower, upper = reference.copy(), reference.copy()
        mean_mass = float(np.mean(reference[: BODY_SIZE * links : BODY_SIZE]))
        longest = max(float(np.linalg.norm(joint.translation)) for joint in model.joints)
        for link in range(links):
            block = slice(BODY_SIZE * link, BODY_SIZE * (link + 1))
            lower[block], upper[block] = _body_box(reference[block], mean_mass, longest)
        values = exact.parameters[list(exact.active)]
        for place in range(BODY_SIZE * links, len(parameters)):
            seen = np.abs(of_active[:, place]) > 0.0
            size = JOINTS * float(np.max(np.abs(values[seen]), initial=0.0))
            upper[place] = size
            kind = parameters[place].kind
            lower[place] = 0.0 if kind not in TERM or TERM[kind].brakes else -size
        lower, upper = _scaled(reference, lower, upper, share, BODY_SIZE * links)
        names = physical_names(model)
        chosen = [place for place in _acting(of_active, links) if lower[place] < upper[place]]
        physical = PhysicalCost(PhysicalParameters.of(model, reference, [names[c] for c in chosen]), cost, of_active)
        box = SearchBox(lower[chosen], upper[chosen], [names[c] for c in chosen])

        def steps(point: FloatArray, deviation: float) -> tuple[Step, ...]:
            return (identified_step(identifiability(physical.derivative(point), deviation, box.names), point),)

        penalty = FeasibilityPenalty.of(priors.links)

        def impossible(points: FloatArray) -> FloatArray:
            bodies = physical.parameters.standard(points)[:, : BODY_SIZE * links].reshape(len(points), links, BODY_SIZE)
            return IMPOSSIBLE * float(np.linalg.norm(cost.target)) * penalty(bodies)

        return Space(box, physical.base, impossible if feasible else no_penalty, steps)

    return space


def _acting(projection: FloatArray, links: int) -> list[int]:
    """Physical parameters that act on some base parameter, for the reference bodies or others."""
    acts = np.any(np.abs(projection) > 0.0, axis=0)
    for link in range(links):
        block = slice(BODY_SIZE * link, BODY_SIZE * (link + 1))
        xx, xy, xz, yy, yz, zz, *firsts, mass = acts[block]
        moments = xx or xy or xz or yy or yz or zz
        # A mass and its centre enter first and second moments; the inertia about it only the second ones.
        acts[block] = [mass or moments or any(firsts), *(bool(first or moments) for first in firsts)] + [
            bool(entry) for entry in (xx, xy, xz, yy, yz, zz)
        ]
    return [int(place) for place in np.flatnonzero(acts)]


def _body_box(body: FloatArray, mean_mass: float, longest: float) -> tuple[FloatArray, FloatArray]:
    """Bounds (10,) about a body's physical parameters."""
    mass, com, moments = body[0], body[1:4], body[[4, 7, 9]]
    heaviest = MASSES[1] * max(mass, mean_mass)
    largest = np.maximum(MASSES[1] * moments, heaviest * (0.5 * longest) ** 2)
    reach = max(REACH * float(np.sqrt(moments.max() / mass)), 0.5 * longest)
    products = PRODUCTS * np.sqrt(np.array([largest[0] * largest[1], largest[0] * largest[2], largest[1] * largest[2]]))
    lower, upper = np.empty(BODY_SIZE), np.empty(BODY_SIZE)
    lower[0], upper[0] = MASSES[0] * mass, heaviest
    lower[1:4], upper[1:4] = com - reach, com + reach
    lower[[4, 7, 9]], upper[[4, 7, 9]] = MASSES[0] * moments, largest
    lower[[5, 6, 8]], upper[[5, 6, 8]] = -products, products
    return lower, upper


def _scaled(
    reference: FloatArray, lower: FloatArray, upper: FloatArray, share: float, of_links: int
) -> tuple[FloatArray, FloatArray]:
    """Ranges (p,) times a factor about the reference; the first `of_links` are bodies' parameters."""
    least, most = reference + share * (lower - reference), reference + share * (upper - reference)
    for entry in POSITIVE:
        place = slice(entry, of_links, BODY_SIZE)
        least[place] = np.maximum(least[place], LEAST_PRIOR * reference[place])
    return least, most


def identified_step(parameters: tuple[ParameterIdentifiability, ...], point: FloatArray) -> Step:
    """Physical parameters of a best point (d,) with what the torque shows of each."""
    settings: dict[str, float | int | str] = {}
    for parameter, value in zip(parameters, point, strict=True):
        settings[parameter.name] = float(value)
        settings[f"{parameter.name} determined"] = round(parameter.determined, 4)
        if parameter.identifiable:
            settings[f"{parameter.name} std"] = parameter.std
    shown = [p.name for p in parameters if p.identifiable]
    hidden = [p.name for p in parameters if not p.identifiable]
    text = f"{len(shown)} of {len(parameters)} are individually identifiable: {', '.join(shown) or 'none'}"
    if hidden:
        text += (
            f"; confounded with others, so their values are arbitrary: {', '.join(hidden)} (result.json has the share "
            "of each that the torque shows)"
        )
    return Step("physical parameters", settings, text)


@dataclass(frozen=True)
class FrogOptions(FrogLeaping):
    """Options of shuffled frog leaping; the defaults are UP6 Table 2's."""

    generations: Annotated[int, within(GENERATIONS), Field(description="G, between shuffles")] = 50
    box: Annotated[
        float, within(BOX_SHARE), Field(description="factor of every search range around the prior body")
    ] = 1.0
    feasible: Annotated[bool, Field(description="penalise physically impossible links")] = False
    seconds: Annotated[float | None, within(SEARCH_TIME), Field(description="time limit [s]; none if absent")] = None
    seed: Annotated[int, within(SEED), Field(description="of the random numbers")] = 0


def _estimator(options: FrogOptions, setup: Setup) -> Estimator:
    budget = SearchBudget(options.generations, options.seconds)
    space = physical_space(setup, options.feasible, options.box)
    return SearchEstimator(setup, weighted_least_squares, space, options, budget, options.seed)


METHOD = Method(
    "shuffled frog leaping over mass, centre of mass, inertia and joint parameters, around the links' prior bodies",
    "torque",
    FrogOptions,
    _estimator,
)
