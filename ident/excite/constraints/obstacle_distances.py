"""Signed distances of points to planes and of segments to boxes, with their derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daq.robot.workspace import Box, HalfSpace
from drivers.core.arrays import FloatArray

_HALVINGS = 24


@dataclass(frozen=True)
class Distances:
    """Signed distances to what must not be touched, negative inside it.

    Attributes:
        value: (K, N) [m].
        point: (K, 3, N) [m], the points of the links that are nearest.
        gradient: (K, 3, N) derivatives by these points.
    """

    value: FloatArray
    point: FloatArray
    gradient: FloatArray


def above_plane(points: FloatArray, half_space: HalfSpace) -> Distances:
    """Distances of points (K, 3, N) to a plane, positive on the side that its normal points to."""
    normal = np.array(half_space.normal) / np.linalg.norm(half_space.normal)
    value = np.einsum("i,kit->kt", normal, points) - half_space.offset
    return Distances(value, points, np.broadcast_to(normal[:, None], points.shape))


def box_distances(start: FloatArray, end: FloatArray, box: Box) -> Distances:
    """Signed distances of segments to a box; their ends are (K, 3, N) [m].

    Along a segment the signed distance is convex, so that its minimum is found by halving. Where the minimum is a kink
    (a segment that goes through the box), the derivative is that mean of both sides' that has no slope along the
    segment.
    """
    middle = 0.5 * (np.array(box.lower) + np.array(box.upper))[:, None]
    half = 0.5 * (np.array(box.upper) - np.array(box.lower))[:, None]
    way = end - start

    def at(share: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        point = start + share[:, None] * way
        value, gradient = _to_box(point - middle, half)
        return value, point, gradient, np.asarray((gradient * way).sum(axis=1))

    low, high = np.zeros_like(start[:, 0]), np.ones_like(start[:, 0])
    for _ in range(_HALVINGS):
        share = 0.5 * (low + high)
        beyond = at(share)[3] > 0.0
        low, high = np.where(beyond, low, share), np.where(beyond, share, high)
    value, point, before, falling = at(low)
    value_after, point_after, after, rising = at(high)
    between = (falling < 0.0) & (rising > 0.0)
    change = np.where(between, rising - falling, 1.0)
    fraction = np.where(between, -falling / change, np.where(falling >= 0.0, 0.0, 1.0))
    # Where the two slopes meet: halving alone would leave the error of the last step.
    to_kink = np.clip((value - value_after + rising * (high - low)) / change, 0.0, high - low)
    to_end = fraction == 1.0
    value = np.where(to_end, value_after, value + np.where(between, falling * to_kink, 0.0))
    return Distances(
        value, np.where(to_end[:, None], point_after, point), before + fraction[:, None] * (after - before)
    )


def _to_box(offset: FloatArray, half: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Signed distance (K, N) of points (K, 3, N) from a box's middle to its surface, and its derivatives (K, 3, N)."""
    beyond = np.abs(offset) - half
    outside = np.maximum(beyond, 0.0)
    distance = np.sqrt((outside**2).sum(axis=1))
    away = distance > 0.0
    direction = outside / np.where(away, distance, 1.0)[:, None]
    nearest_face = np.moveaxis(np.eye(3)[np.argmax(beyond, axis=1)], -1, 1)
    gradient = np.sign(offset) * np.where(away[:, None], direction, nearest_face)
    return np.where(away, distance, beyond.max(axis=1)), gradient
