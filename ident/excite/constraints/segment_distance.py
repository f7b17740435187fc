"""Distances of straight segments, for many pairs and samples at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray

_TOUCHING = 1e-9
"""Segments closer than this [m] cross; the difference of their nearest points has no direction any more."""


@dataclass(frozen=True)
class Nearest:
    """The nearest points of pairs of segments.

    Attributes:
        distance: (K, N) [m].
        first, second: (K, 3, N) [m], the points.
        normal: (K, 3, N) unit vectors from second to first; across both segments where they cross.
    """

    distance: FloatArray
    first: FloatArray
    second: FloatArray
    normal: FloatArray


def nearest_points(start1: FloatArray, end1: FloatArray, start2: FloatArray, end2: FloatArray) -> Nearest:
    """Nearest points of segments start1-end1 and start2-end2, ends (K, 3, N) [m]; a segment may be a point.

    The point that is nearest on the two infinite lines is moved to the ends of one segment, then of the other
    (Ericson, Real-Time Collision Detection, .5.1.9).
    """
    way1, way2 = end1 - start1, end2 - start2
    apart = start1 - start2
    a, e, b = _dot(way1, way1), _dot(way2, way2), _dot(way1, way2)
    c, f = _dot(way1, apart), _dot(way2, apart)
    area = a * e - b * b
    s = np.clip(_quotient(b * f - c * e, area, 1e-14 * a * e), 0.0, 1.0)
    t = np.clip(_quotient(b * s + f, e, 0.0), 0.0, 1.0)
    s = np.clip(_quotient(b * t - c, a, 0.0), 0.0, 1.0)
    first, second = start1 + s[:, None] * way1, start2 + t[:, None] * way2
    difference = first - second
    distance = np.sqrt(_dot(difference, difference))
    crossing = distance < _TOUCHING
    if np.any(crossing):
        difference = np.where(crossing[:, None], _across(way1, way2), difference)
    length = np.where(crossing, np.sqrt(_dot(difference, difference)), distance)
    return Nearest(distance, first, second, difference / length[:, None])


def _dot(left: FloatArray, right: FloatArray) -> FloatArray:
    return left[:, 0] * right[:, 0] + left[:, 1] * right[:, 1] + left[:, 2] * right[:, 2]


def _quotient(numerator: FloatArray, denominator: FloatArray, least: FloatArray | float) -> FloatArray:
    """Quotient, 0 where the denominator is not above `least` (parallel segments, or a point)."""
    usable = denominator > least
    return np.where(usable, numerator / np.where(usable, denominator, 1.0), 0.0)


def _across(way1: FloatArray, way2: FloatArray) -> FloatArray:
    """(K, 3, N) directions across both ways; across the longer one where they are parallel."""
    both = np.cross(way1, way2, axis=1)
    longer = np.where((_dot(way1, way1) >= _dot(way2, way2))[:, None], way1, way2)
    smallest = np.argmin(np.abs(longer), axis=1)
    helper = np.moveaxis(np.eye(3)[smallest], -1, 1)
    alone = np.cross(longer, helper, axis=1)
    point = np.where(_dot(alone, alone)[:, None] > 0.0, alone, np.array([0.0, 0.0, 1.0])[:, None])
    parallel = _dot(both, both) <= 1e-16 * _dot(way1, way1) * _dot(way2, way2)
    return np.where(parallel[:, None], point, both)
