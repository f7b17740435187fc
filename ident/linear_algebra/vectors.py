"""Products and rotations of 3-vectors, for many samples at once."""

from __future__ import annotations

import functools
import math

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import FloatArray


def cross(left: FloatArray, right: FloatArray) -> FloatArray:
    """Cross product of (…, 3, m) arrays; np.cross is three times slower on short ones."""
    product = np.empty(np.broadcast(left, right).shape)
    for component, (first, second) in enumerate(((1, 2), (2, 0), (0, 1))):
        out = product[..., component, :]
        np.multiply(left[..., first, :], right[..., second, :], out=out)
        out -= left[..., second, :] * right[..., first, :]
    return product


def cross_matrix(vector: FloatArray) -> FloatArray:
    """[v]× (3, 3) of a vector (3,): its product with another one is their cross product."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def axis_rotation(axis: FloatArray, angle: npt.ArrayLike) -> FloatArray:
    """Rotations (3, 3, …) about a unit vector (3,) by angles (…) [rad], by Rodrigues' formula."""
    angle, (unit, matrix, square) = np.asarray(angle), _turning(*axis.tolist())
    turned = np.multiply.outer(matrix, np.sin(angle)) + np.multiply.outer(square, 1.0 - np.cos(angle))
    return np.asarray(unit.reshape(3, 3, *[1] * angle.ndim) + turned)


@functools.lru_cache(1024)
def _turning(x: float, y: float, z: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The unit matrix, [v]× and its square, of an axis; a search asks for those of the same arm thousands of times."""
    matrix = cross_matrix(np.array([x, y, z]))
    return np.eye(3), matrix, matrix @ matrix


def rotation_of(roll: float, pitch: float, yaw: float) -> FloatArray:
    """Rotation (3, 3) Rz(yaw)·Ry(pitch)·Rx(roll) of these angles [rad]."""
    cr, sr, cp, sp, cy, sy = (f(angle) for angle in (roll, pitch, yaw) for f in (math.cos, math.sin))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
