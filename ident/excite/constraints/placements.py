"""Placements of the links along a path, and the Jacobians of points on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from drivers.core.arrays import FloatArray, IndexArray
from ident.linear_algebra.vectors import axis_rotation, cross
from ident.model.dynamic_model import DynamicModel
from ident.model.kinematics.joints import BASE_INDEX, Joint, ancestors

_MOST_STRIPS = 4
"""A flat box gets at most so many capsules side by side."""

_LENGTHS_TRIED = 21


@dataclass(frozen=True)
class Capsule:
    """All points within `radius` of a segment that is fixed to a link."""

    link: int  # index of the link's joint; `BASE_INDEX` for the base
    # start, end: (3,) [m] in the link's frame; equal for a sphere
    start: FloatArray
    end: FloatArray
    radius: float  # [m]


def cylinder_capsule(link: int, rotation: FloatArray, centre: FloatArray, radius: float, length: float) -> Capsule:
    """The capsule around a cylinder along its frame's z axis; a sphere where the length is 0."""
    half = 0.5 * length * rotation[:, 2]
    return Capsule(link, centre - half, centre + half, radius)


def box_capsules(link: int, rotation: FloatArray, centre: FloatArray, sides: Sequence[float]) -> list[Capsule]:
    """Capsules around a box with full `sides` (3,) [m]: side by side where it is flat."""
    order = np.argsort(sides)[::-1]
    wide, thin = sides[order[1]], sides[order[2]]
    strips = int(np.clip(np.ceil(wide / thin), 1, _MOST_STRIPS))
    capsules = []
    for strip in range(strips):
        half = 0.5 * np.array(sides, dtype=np.float64)
        half[order[1]] /= strips
        middle = np.zeros(3)
        middle[order[1]] = wide * ((strip + 0.5) / strips - 0.5)
        corners = np.array([middle + half * signs for signs in product((-1.0, 1.0), repeat=3)])
        capsules.append(enclosing_capsule(link, centre + corners @ rotation.T))
    return capsules


def enclosing_capsule(link: int, points: FloatArray) -> Capsule:
    """A capsule around points (V, 3) [m] and their convex hull, along their longest principal axis.

    Of segments of several lengths on that axis, the one whose capsule has the smallest volume.
    """
    middle = points.mean(axis=0)
    directions = np.linalg.eigh((points - middle).T @ (points - middle))[1].T
    local = (points - middle) @ directions.T
    lower, upper = local.min(axis=0), local.max(axis=0)
    order = np.argsort(upper - lower)[::-1]
    directions, local = directions[order], local[:, order]
    centre = 0.5 * (lower + upper)[order]
    along = np.abs(local[:, 0] - centre[0])
    across = np.hypot(local[:, 1] - centre[1], local[:, 2] - centre[2])
    halves = np.linspace(0.0, float(along.max()), _LENGTHS_TRIED)
    radii = np.array([float(np.hypot(np.maximum(along - half, 0.0), across).max()) for half in halves])
    best = int(np.argmin(radii**2 * (2.0 * halves + 4.0 / 3.0 * radii)))
    origin = middle + centre @ directions
    return Capsule(link, origin - halves[best] * directions[0], origin + halves[best] * directions[0], radii[best])


@dataclass(frozen=True)
class Placements:
    """The frames of all joints along a path, in the base frame; the last entry of the first axis is the base itself."""

    rotation: FloatArray  # (n + 1, 3, 3, N)
    origin: FloatArray  # (n + 1, 3, N) [m]
    # (n, 6, N) velocity of all that a joint moves per unit of its own: angular, then linear at the base frame's origin.
    # A point p moves with linear + angular × p.
    screw: FloatArray

    def points(self, links: IndexArray, local: FloatArray) -> FloatArray:
        """Points (K, 3, N) [m] from the numbers (K,) of their links and their places (K, 3) in the links' frames."""
        return np.asarray(self.origin[links] + np.einsum("kijt,kj->kit", self.rotation[links], local))


def place(joints: tuple[Joint, ...], position: FloatArray) -> Placements:
    """Forward kinematics of all samples of a path (n, N) at once."""
    count = position.shape[1]
    rotation = np.empty((len(joints) + 1, 3, 3, count))
    origin = np.zeros((len(joints) + 1, 3, count))
    screw = np.zeros((len(joints), 6, count))
    rotation[BASE_INDEX] = np.eye(3)[:, :, None]
    for index, (joint, q) in enumerate(zip(joints, position, strict=True)):
        before = rotation[joint.parent]
        local = joint.translation[:, None] + (np.outer(joint.rotation @ joint.axis, q) if joint.prismatic else 0.0)
        origin[index] = origin[joint.parent] + np.einsum("ijt,jt->it", before, np.broadcast_to(local, (3, count)))
        start = np.einsum("ijt,jk->ikt", before, joint.rotation)
        axis = np.einsum("ijt,j->it", start, joint.axis)
        if joint.prismatic:
            rotation[index] = start
            screw[index, 3:] = axis
        else:
            rotation[index] = np.einsum("ijt,jkt->ikt", start, axis_rotation(joint.axis, q))
            screw[index, :3] = axis
            screw[index, 3:] = cross(origin[index], axis)
    return Placements(rotation, origin, screw)


def place_arm(model: DynamicModel, position: FloatArray) -> Placements:
    """The same for positions (dof, N) of the joints with a motor; the others follow."""
    for placed, along, placements in _LAST:
        if placed is model and np.array_equal(along, position):
            return placements
    placements = place(model.joints, model.tree_position(position))
    _LAST[:] = [(model, position.copy(), placements)]
    return placements


_LAST: list[tuple[DynamicModel, FloatArray, Placements]] = []
"""The arm that was placed last, and along what: the limits of a design ask for the same, one after the other."""


def tool_point(model: DynamicModel, placements: Placements, tool: Sequence[float]) -> FloatArray:
    """Tool point (3, N) [m] in the base frame along a path; it is given in the last joint's frame (3,) [m]."""
    return np.asarray(placements.points(np.array([model.tool_link]), np.array([tool]))[0])


def moved_by(joints: tuple[Joint, ...]) -> FloatArray:
    """(n + 1, n): 1 where a joint (column) moves a link (row), else 0; the last row, zero, is the base's."""
    moves = np.zeros((len(joints) + 1, len(joints)))
    for index in range(len(joints)):
        moves[index, [*ancestors(joints, index), index]] = 1.0
    return moves


def wrench(point: FloatArray, gradient: FloatArray) -> FloatArray:
    """(K, 6, N): moment and force of gradients (K, 3, N) at points (K, 3, N).

    Its product with a joint's screw is the derivative by that joint of a scalar with these derivatives by the points.
    """
    (x, y, z), (a, b, c) = np.moveaxis(point, -2, 0), np.moveaxis(gradient, -2, 0)
    return np.stack([y * c - z * b, z * a - x * c, x * b - y * a, a, b, c], axis=-2)
