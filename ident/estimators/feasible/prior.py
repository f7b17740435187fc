"""Assumptions on links where data are inconclusive: bodies of the robot file, of the URDF, or of uniform density.

Torques never reveal all of a link's ten parameters. The others come from a prior, a body that can
exist for every link. It is never mixed up with what was identified: see `ConsistentParameters.determined`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daq.robot.loader import RobotFile
from daq.robot.prior import PriorLink
from drivers.core.arrays import FloatArray
from drivers.core.errors import RobotFileError
from ident.assessment.arm_mass import arm_length, mass_of_size
from ident.estimators.feasible.pseudo_inertia import pseudo_inertia, standard_parameters
from ident.linear_algebra.inequalities import nonnegative_least_squares
from ident.linear_algebra.triangular import triangular
from ident.model.dynamic_model import DynamicModel
from ident.model.kinematics.urdf import urdf_inertias
from ident.model.parameters import INERTIAL, inertia_tensor, link_parameters

SLENDERNESS, TAPER = 0.04, 0.05
"""Radius of an assumed link: so much of the whole arm's length, and of the length that the link carries."""

LEAST_SPREAD = 1e-3
"""[m]; bodies of a URDF whose mass is spread less far than this about their centre count as assumed."""

LEAST_RADIUS = 0.03
"""[m] of assumed links."""

DENSITY = 1000.0
"""[kg/m³] of assumed bodies where neither the data nor the arm's size shows how heavy they are."""

LENGTH_SHARE, WIDTH_DEVIATION = 0.04, 0.5
"""σ of a link's centre of mass over the arm's length, and of its widths, where the links' masses are estimated."""

TOOL_SHARE = 0.1
"""Share of the arm's length: how far a tool or a gripper may move the last link's centre of mass."""


@dataclass(frozen=True)
class LinkPriors:
    """A body for each link of the tree."""

    links: FloatArray  # (k, 10) standard parameters; each link's pseudo-inertia is positive definite
    # (k,) where each comes from: "robot file", "robot file (mass)", "robot file (mass, centre of mass)", "urdf" or
    # "assumed"
    sources: tuple[str, ...]
    mass_std: FloatArray  # (k,) how far each mass may plausibly be from that [kg]
    centre_std: FloatArray  # (k,) the same of each centre of mass [m]


def link_priors(model: DynamicModel, robot_file: RobotFile, system: FloatArray, target: FloatArray) -> LinkPriors:
    """Prior bodies of an arm.

    Args:
        model: the arm.
        robot_file: its file; the links of its `prior`, else those of its URDF, are used where they can exist.
        system: (m, p) weighted combinations of standard parameters that the data show, their errors of unit variance.
        target: (m,) their values; the assumed links get the density that fits these best, within what arms of this
            size weigh (`mass_of_size`).

    Raises:
        RobotFileError: a body of `prior` cannot exist.
    """
    robot, sources = robot_file.robot, ["assumed"] * len(model.joints)
    of_urdf = {
        index: body
        for index, body in enumerate(urdf_inertias(robot_file, model.link_names))
        if body is not None and _extended(body[0], body[2])
    }
    complete = len(of_urdf) == len(sources)
    links = np.zeros((len(sources), 10)) if complete else _assumed_links(model, system, target)
    for index, (mass, centre, inertia) in of_urdf.items():
        xx, xy, xz, yy, yz, zz = inertia[np.triu_indices(3)]
        links[index], sources[index] = link_parameters(mass, tuple(centre), (xx, xy, xz, yy, yz, zz)), "urdf"
    for index, name in enumerate(model.link_names):
        if name in robot.prior.links and robot.prior.links[name].mass is not None:
            where = f"{robot.name}: prior.links.{name}"
            links[index], sources[index] = _described(links[index], robot.prior.links[name], where)
    masses = links[:, INERTIAL.index("M")]
    return LinkPriors(links, tuple(sources), np.maximum(masses, masses.mean()), _centre_std(model))


def apparent_mass(model: DynamicModel, links: FloatArray, system: FloatArray, target: FloatArray) -> float | None:
    """Mass [kg] of all links if they were like these (k, 10), heavier or lighter; None if below 0.

    The torques show it by two estimates (`_factors`); the mass between them that is nearest to what arms of this size
    weigh. Arguments as of `link_priors`. The joints' own parameters may take what they like, so that only what is left
    of the links' torques shows it.
    """
    least, most = np.sum(links[:, INERTIAL.index("M")]) * np.array(_factors(model, links, system, target))
    size = mass_of_size(model)
    if not least > 0.0:
        return None
    return float(np.sqrt(least * most) if size is None else np.clip(size.expected, least, most))


def _factors(model: DynamicModel, links: FloatArray, system: FloatArray, target: FloatArray) -> tuple[float, float]:
    """Factors by which all links together are heavier, estimated in two ways, the smaller one first.

    Once all links are heavier by one factor, which is that of the wrist, whose torques are measured best. Then each has
    its own, its centre and second moments being uncertain: of those that explain the data, with no mass below 0, the
    ones that need the least deviations. These are wrong where links are not shaped as assumed.
    """
    from scipy.linalg import block_diag, null_space

    own, count = system[:, links.size :], len(links)
    lengths = np.linalg.norm(own, axis=0)
    own = own[:, lengths > 0] / lengths[lengths > 0]
    together = np.column_stack([system[:, : links.size] @ links.ravel(), own])
    longest = max(float(np.linalg.norm(together[:, 0])), np.finfo(float).tiny)
    common = float(np.linalg.lstsq(together / [longest, *np.ones(own.shape[1])], target, rcond=None)[0][0]) / longest
    if common <= 0.0:
        return common, common
    left = null_space(own.T).T @ np.column_stack([common * system[:, : links.size], target])
    shift = max(LENGTH_SHARE * arm_length(model), LEAST_RADIUS)
    changes = left[:, :-1] @ _deviations(links, shift)
    masses = left[:, :-1] @ block_diag(*links[:, :, None])
    # Unknowns: deviations, the links' factors and their mean; last the right-hand side.
    rows = np.zeros((changes.shape[1] + count, changes.shape[1] + count + 2))
    rows[: changes.shape[1], : changes.shape[1]] = np.eye(changes.shape[1])
    weights = links[:, INERTIAL.index("M")]
    relative = np.minimum(1.0, weights / weights.mean())
    rows[changes.shape[1] :, changes.shape[1] : -2] = np.diag(relative)
    rows[changes.shape[1] :, -2] = -relative
    measured = np.hstack([changes, masses, np.zeros((len(left), 1)), left[:, -1:]])
    rest = triangular(np.vstack([measured, rows]))[changes.shape[1] :, changes.shape[1] :]
    # The mean, which may be negative, as the difference of two values that may not.
    factors = nonnegative_least_squares(np.hstack([rest[:, :-1], -rest[:, -2:-1]]), rest[:, -1])
    if factors is None:
        return common, common
    own_factors = common * float(factors[:count] @ weights) / float(weights.sum())
    return min(common, own_factors), max(common, own_factors)


def _deviations(links: FloatArray, shift: float) -> FloatArray:
    """Changes (10·k, 9·k) of links (k, 10) by one σ each: of the centre by `shift` [m], and of the second moments."""
    from scipy.linalg import block_diag

    pseudo, centres = pseudo_inertia(links)[:, None], links[:, 6:9] / links[:, 9:]
    rates = np.zeros((len(links), 9, 4, 4))
    rates[:, range(3), range(3), 3] = shift
    axis, other = np.triu_indices(3)
    rates[:, range(3, 9), axis, other] = WIDTH_DEVIATION
    rates[:, range(3, 9), axis, 3] = -WIDTH_DEVIATION * centres[:, other]
    changes = standard_parameters(rates @ pseudo + pseudo @ rates.swapaxes(2, 3))
    return np.asarray(block_diag(*changes.swapaxes(1, 2)))


def _centre_std(model: DynamicModel) -> FloatArray:
    """(k,) [m]: half the way to the farthest joint that a link carries, its thickness, and a tool on the last."""
    length = arm_length(model)
    extents = np.zeros(len(model.joints))
    for joint in model.joints:
        if joint.parent >= 0:
            extents[joint.parent] = max(extents[joint.parent], float(np.linalg.norm(joint.translation)))
    spread = 0.5 * extents + max(SLENDERNESS * length, LEAST_RADIUS)
    spread[model.tool_link] += TOOL_SHARE * length
    return spread


def _described(link: FloatArray, stated: PriorLink, where: str) -> tuple[FloatArray, str]:
    """A link (10,) with the mass, centre and inertia that are known of it, and its source in words."""
    if stated.mass is None:
        raise ValueError("nothing is known about this link")
    scaled = link * (stated.mass / link[9])
    if stated.com is None:
        return scaled, "robot file (mass)"
    if stated.inertia is None:
        pseudo = pseudo_inertia(scaled)
        old, new = np.append(scaled[6:9] / stated.mass, 1.0), np.append(stated.com, 1.0)
        moved = pseudo + stated.mass * (np.outer(new, new) - np.outer(old, old))
        return standard_parameters(moved), "robot file (mass, centre of mass)"
    described = link_parameters(stated.mass, stated.com, stated.inertia)
    if not can_exist(stated.mass, stated.inertia):
        raise RobotFileError(
            "no body has this inertia: each principal moment must be below the sum of the other two",
            where=where,
            hint="give it about the centre of mass, in kg·m², in the axes of the joint's frame",
        )
    return described, "robot file"


def can_exist(mass: float, inertia: Sequence[float]) -> bool:
    """Return whether a body has this mass [kg] and inertia xx, xy, xz, yy, yz, zz about its centre of mass [kg·m²]."""
    return _extended(mass, inertia_tensor(inertia))


def uniform_ball(mass: float, com: FloatArray) -> FloatArray:
    """Standard parameters (10,) of a ball of the assumed density, mass [kg] and centre (3,) [m]."""
    radius = float(np.cbrt(mass / DENSITY * 3 / (4 * np.pi)))
    moment = 2 / 5 * mass * radius**2
    return link_parameters(mass, com.tolist(), (moment, 0.0, 0.0, moment, 0.0, moment))


def _extended(mass: float, inertia: FloatArray) -> bool:
    """Whether a body's mass is spread out in all three directions, so that its pseudo-inertia is positive definite."""
    if not (mass > 0 and np.all(np.isfinite(inertia))):
        return False
    second_moments = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    return bool(np.linalg.eigvalsh(second_moments)[0] > mass * LEAST_SPREAD**2)


def _assumed_links(model: DynamicModel, system: FloatArray, target: FloatArray) -> FloatArray:
    """Standard parameters (k, 10) of round bars from each joint's frame to those of the joints it carries."""
    children: list[list[FloatArray]] = [[] for _ in model.joints]
    for joint in model.joints:
        if joint.parent >= 0:
            children[joint.parent].append(joint.translation)
    carried = np.zeros(len(model.joints))
    for joint in reversed(model.joints):
        if joint.parent >= 0:
            behind = carried[model.joints.index(joint)] + float(np.linalg.norm(joint.translation))
            carried[joint.parent] = max(carried[joint.parent], behind)
    radii = np.maximum(SLENDERNESS * arm_length(model) + TAPER * carried, LEAST_RADIUS)
    bars = np.array([_bars(ends, radius) for ends, radius in zip(children, radii.tolist(), strict=True)])
    mass, size = float(np.sum(bars[:, INERTIAL.index("M")])), mass_of_size(model)
    shown = apparent_mass(model, bars, system, target)
    if size is None:
        return bars * (DENSITY if shown is None else shown / mass)
    return bars * ((size.expected if shown is None else np.clip(shown, size.least, size.most)) / mass)


def _bars(ends: Sequence[FloatArray], radius: float) -> FloatArray:
    """Standard parameters (10,) of bars of 1 kg/m³ from the origin to `ends`; of a ball where there are none."""
    pseudo = np.zeros((4, 4))
    for end in ends or (np.zeros(3),):
        length = float(np.linalg.norm(end))
        mass = np.pi * radius**2 * (length + 4 / 3 * radius)
        centre = np.append(0.5 * end, 1.0)
        pseudo += mass * np.outer(centre, centre)
        pseudo[:3, :3] += mass * (np.outer(end, end) / 12 + radius**2 / 4 * np.eye(3))
    return standard_parameters(pseudo)
