"""Kinematics from the modified Denavit-Hartenberg parameters of Khalil and Kleinfinger (ICRA 1986), trees included."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from daq.robot.schema import BASE, MdhRow
from drivers.core.arrays import FloatArray
from ident.model.kinematics.joints import Joint

Z_AXIS = np.array([0.0, 0.0, 1.0])


def mdh_joints(rows: Sequence[MdhRow]) -> tuple[Joint, ...]:
    """Joints of a modified-DH table; the axis of joint j is frame j's z axis, positions start at `theta0` or `r`."""
    joint_index = {BASE: -1} | {row.joint: index for index, row in enumerate(rows)}
    joints = []
    for row in rows:
        rotation, translation = mdh_placement(row)
        joints.append(
            Joint(
                name=row.joint,
                parent=joint_index[row.antecedent],
                prismatic=row.type == "prismatic",
                rotation=rotation,
                translation=translation,
                axis=Z_AXIS,
            )
        )
    return tuple(joints)


def mdh_placement(row: MdhRow) -> tuple[FloatArray, FloatArray]:
    """Rotation (3, 3) and translation (3,) [m] of a frame in its antecedent's at joint position zero."""
    # Rot(z, gamma) Trans(z, b) Rot(x, alpha) Trans(x, d) Rot(z, theta0) Trans(z, r)
    base_turn = _rotation_z(row.gamma)
    tilt = base_turn @ _rotation_x(row.alpha)
    rotation = tilt @ _rotation_z(row.theta0)
    translation = base_turn @ np.array([0.0, 0.0, row.b]) + tilt @ np.array([row.d, 0.0, row.r])
    return rotation, translation


def _cos_sin(angle: float) -> tuple[float, float]:
    """Cosine and sine, exactly 0 or ±1 at multiples of π/2, so that products with them can be skipped."""
    quarter_turns = angle / (math.pi / 2)
    if abs(quarter_turns - round(quarter_turns)) < 1e-12:
        return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[round(quarter_turns) % 4]
    return math.cos(angle), math.sin(angle)


def _rotation_x(angle: float) -> FloatArray:
    c, s = _cos_sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _rotation_z(angle: float) -> FloatArray:
    c, s = _cos_sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
