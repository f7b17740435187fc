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
from ident.model.dynamic_model import DynamicModel
from ident.model.kinematics.urdf import urdf_inertias
from ident.model.parameters import INERTIAL, link_parameters

SLENDERNESS, TAPER = 0.04, 0.05
"""Radius of an assumed link: so much of the whole arm's length, and of the length that the link carries."""

LEAST_SPREAD = 1e-3
"""[m]; bodies of a URDF whose mass is spread less far than this about their centre count as assumed."""

LEAST_RADIUS = 0.03
"""[m] of assumed links."""

DENSITY = 1000.0
"""[kg/m³] of assumed bodies where neither the data nor the arm's size shows how heavy they are."""

MASS_DEVIATION, LENGTH_SHARE, WIDTH_DEVIATION = 1.0, 0.04, 0.5
"""σ of a link's mass over the assumed one, of its centre over the arm's length, and of its widths. The mass that 24
random arms show so is 0.3 to 1.4 of the true one, wrists of a tenth of the usual mass included."""

TOOL_SHARE = 0.1
"""Of the arm's length: how far a tool or a gripper may move the last link's centre of mass."""


@dataclass(frozen=True)
class LinkPriors:
    """A body for each link of the tree.

    Attributes:
        links: (k, 10) standard parameters; each link's pseudo-inertia is positive definite.
        sources: (k,) where each comes from: "robot file", "robot file (mass)", "robot file (mass, centre of mass)",
            "urdf" or "assumed".
        mass_std: (k,) how far each mass may plausibly be from that [kg].
        centre_std: (k,) the same of each centre of mass [m].
    """

    links: FloatArray
    sources: tuple[str, ...]
    mass_std: FloatArray
    centre_std: FloatArray


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
    links, sources = _assumed_links(model, system, target), ["assumed"] * len(model.joints)
    robot = robot_file.robot
    if robot_file.urdf_text:
        bodies = urdf_inertias(robot_file.urdf_text, model.link_names, robot.model.locked, robot.name)
        for index, body in enumerate(bodies):
            if body is not None and _extended(body[0], body[2]):
                xx, xy, xz, yy, yz, zz = body[2][np.triu_indices(3)]
                links[index] = link_parameters(body[0], tuple(body[1]), (xx, xy, xz, yy, yz, zz))
                sources[index] = "urdf"
    for index, name in enumerate(model.link_names):
        if name in robot.prior.links and robot.prior.links[name].mass is not None:
            where = f"{robot.name}: prior.links.{name}"
            links[index], sources[index] = _described(links[index], robot.prior.links[name], where)
    masses = links[:, INERTIAL.index("M")]
    return LinkPriors(links, tuple(sources), np.maximum(masses, masses.mean()), _centre_std(model))


def apparent_mass(model: DynamicModel, links: FloatArray, system: FloatArray, target: FloatArray) -> float | None:
    """Mass [kg] of all links if they were like these (k, 10), heavier or lighter by a factor; None if below 0.

    Arguments as of `link_priors`. The joints' own parameters may take what they like, so that only what is left of the
    links' torques shows it.
    """
    factor = _factor(model, links, system, target)
    return float(factor * np.sum(links[:, INERTIAL.index("M")])) if factor > 0 else None


def _factor(model: DynamicModel, links: FloatArray, system: FloatArray, target: FloatArray) -> float:
    """By how much the links are heavier on average, each link's mass, centre and widths being uncertain.

    One factor for all of them would be that of the wrist, whose torques are measured best. It only gives the size of
    the links' deviations, whose covariance generalised least squares then take into account.
    """
    total, own = system[:, : links.size] @ links.ravel(), system[:, links.size :]
    columns = np.column_stack([total, own])
    common = float(_fitted(columns, target)[0])
    if common == 0.0:
        return common
    shift = max(LENGTH_SHARE * arm_length(model), LEAST_RADIUS)
    spread = common * system[:, : links.size] @ _deviations(links, shift)
    expected = np.hstack([np.zeros((spread.shape[1], columns.shape[1])), np.eye(spread.shape[1])])
    weighted = np.vstack([np.hstack([columns, spread]), expected])
    return float(_fitted(weighted, np.concatenate([target, np.zeros(len(expected))]))[0])


def _fitted(columns: FloatArray, target: FloatArray) -> FloatArray:
    lengths = np.linalg.norm(columns, axis=0)
    lengths[lengths == 0] = 1.0
    return np.asarray(np.linalg.lstsq(columns / lengths, target, rcond=None)[0] / lengths)


def _deviations(links: FloatArray, shift: float) -> FloatArray:
    """Changes (10·k, 7·k) of links (k, 10) by one σ each: of mass, of the centre by `shift` [m], and of the widths."""
    changes = np.zeros((links.size, 7 * len(links)))
    for link, body in enumerate(links):
        pseudo, centre = pseudo_inertia(body), body[6:9] / body[9]
        rates = [0.5 * MASS_DEVIATION * np.eye(4)]
        for axis in range(3):
            moved, widened = np.zeros((4, 4)), np.zeros((4, 4))
            moved[axis, 3] = shift
            widened[axis, [axis, 3]] = WIDTH_DEVIATION * np.array([1.0, -centre[axis]])
            rates += [moved, widened]
        for number, rate in enumerate(rates):
            row, column = len(body) * link, len(rates) * link + number
            changes[row : row + len(body), column] = standard_parameters(rate @ pseudo + pseudo @ rate.T)
    return changes


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


def _described(link: FloatArray, known: PriorLink, where: str) -> tuple[FloatArray, str]:
    """A link (10,) with the mass, centre and inertia that are known of it, and its source in words."""
    if known.mass is None:
        raise ValueError("nothing is known of this link")
    scaled = link * (known.mass / link[9])
    if known.com is None:
        return scaled, "robot file (mass)"
    if known.inertia is None:
        pseudo = pseudo_inertia(scaled)
        old, new = np.append(scaled[6:9] / known.mass, 1.0), np.append(known.com, 1.0)
        moved = pseudo + known.mass * (np.outer(new, new) - np.outer(old, old))
        return standard_parameters(moved), "robot file (mass, centre of mass)"
    described = link_parameters(known.mass, known.com, known.inertia)
    if not can_exist(known.mass, known.inertia):
        raise RobotFileError(
            "no body has this inertia: each principal moment must be below the sum of the other two",
            where=where,
            hint="give it about the centre of mass, in kg·m², in the axes of the joint's frame",
        )
    return described, "robot file"


def can_exist(mass: float, inertia: Sequence[float]) -> bool:
    """Whether a body has this mass [kg] and inertia xx, xy, xz, yy, yz, zz about its centre of mass [kg·m²]."""
    xx, xy, xz, yy, yz, zz = inertia
    return _extended(mass, np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))


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
    density = _factor(model, bars, system, target)
    if size is None:
        return bars * (density if density > 0 else DENSITY)
    return bars * ((np.clip(density * mass, size.least, size.most) if density > 0 else size.expected) / mass)


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
