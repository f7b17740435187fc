"""Numbers and orientations as XML attributes hold them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable

from drivers.core.arrays import FloatArray


def number(value: float) -> str:
    """The shortest text that reads back as the same number; an integer without its `.0`, and never `-0`."""
    text = repr(float(value) + 0.0)
    return text.removesuffix(".0")


def numbers(values: Iterable[float]) -> str:
    """Several of them, separated by blanks."""
    return " ".join(number(value) for value in values)


def roll_pitch_yaw(rotation: FloatArray) -> tuple[float, float, float]:
    """Angles [rad] of R = Rz(yaw)·Ry(pitch)·Rx(roll), exact to rounding also at pitch ±π/2."""
    yaw = math.atan2(rotation[1, 0], rotation[0, 0])
    c, s = math.cos(yaw), math.sin(yaw)
    pitch = math.atan2(-rotation[2, 0], c * rotation[0, 0] + s * rotation[1, 0])
    roll = math.atan2(s * rotation[0, 2] - c * rotation[1, 2], c * rotation[1, 1] - s * rotation[0, 1])
    return roll, pitch, yaw


def quaternion(rotation: FloatArray) -> tuple[float, float, float, float]:
    """Unit quaternion w, x, y, z of a rotation (3, 3)."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    return float(w), float(x), float(y), float(z)


def comment_text(lines: Iterable[str]) -> str:
    """Lines as a comment may hold them: XML forbids two hyphens in a row there, and one at the end."""
    return "\n".join(re.sub("-(?=-)", "- ", line) for line in lines).rstrip("-") + "\n"
