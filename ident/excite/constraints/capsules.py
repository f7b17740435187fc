"""Capsules, and those that enclose other shapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from drivers.core.arrays import FloatArray

_MOST_STRIPS = 4
"""A flat box gets at most so many capsules side by side."""

_LENGTHS_TRIED = 21


@dataclass(frozen=True)
class Capsule:
    """All points within `radius` of a segment that is fixed to a link.

    Attributes:
        link: index of the link's joint; `BASE_INDEX` for the base.
        start, end: (3,) [m] in the link's frame; equal for a sphere.
        radius: [m].
    """

    link: int
    start: FloatArray
    end: FloatArray
    radius: float


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
