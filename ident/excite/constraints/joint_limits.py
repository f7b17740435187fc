"""Constraints of an excitation: position, velocity and acceleration of every joint (AUBO eq. 21)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daq.robot.schema import JointLimits
from drivers.core.arrays import FloatArray
from ident.excite.constraints.soft_maximum import soft_maximum
from ident.excite.path import JointPath


@dataclass(frozen=True)
class _Bound:
    """factor · (quantity − middle) ≤ 1 for one joint; `both` where −factor is bound in the same way."""

    name: str
    quantity: int  # 0 position, 1 velocity, 2 acceleration
    joint: int
    middle: float
    factor: float
    both: bool


class JointMotionLimits:
    """Utilisation of the joints' ranges, speeds and accelerations; infinite limits do not count.

    A position uses (q − middle)/(half the range) of the upper limit and the opposite of the lower one; velocity and
    acceleration use their magnitude over the limit.
    """

    def __init__(self, limits: Sequence[JointLimits]) -> None:
        bounds = []
        for joint, limit in enumerate(limits):
            low, high = limit.position
            if np.isfinite(low) and np.isfinite(high):
                middle, half = 0.5 * (low + high), 0.5 * (high - low)
                bounds.append(_Bound(f"upper position limit of {limit.name}", 0, joint, middle, 1.0 / half, False))
                bounds.append(_Bound(f"lower position limit of {limit.name}", 0, joint, middle, -1.0 / half, False))
            for quantity, name, largest in ((1, "velocity", limit.velocity), (2, "acceleration", limit.acceleration)):
                if np.isfinite(largest):
                    bounds.append(_Bound(f"{name} of {limit.name}", quantity, joint, 0.0, 1.0 / largest, True))
        self._bounds = tuple(bounds)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the limits, such as `velocity of elbow`."""
        return tuple(bound.name for bound in self._bounds)

    def use(self, path: JointPath) -> FloatArray:
        """(m,) largest use on the grid."""
        used = [self._of(bound, path) for bound in self._bounds]
        pairs = zip(self._bounds, used, strict=True)
        return np.array([float(np.max(np.abs(values) if bound.both else values)) for bound, values in pairs])

    def smooth_use(self, path: JointPath, sharpness: float) -> tuple[FloatArray, FloatArray]:
        """Smooth upper bound (m,) and its derivatives (m, 3, n, N)."""
        bounds = np.empty(len(self._bounds))
        gradient = np.zeros((len(self._bounds), 3, *path.position.shape))
        count = path.time.size
        for row, bound in enumerate(self._bounds):
            values = self._of(bound, path)
            signed = np.concatenate([values, -values]) if bound.both else values
            bounds[row], weights = soft_maximum(signed, sharpness)
            by_value = weights[:count] - weights[count:] if bound.both else weights
            gradient[row, bound.quantity, bound.joint] = bound.factor * by_value
        return bounds, gradient

    def _of(self, bound: _Bound, path: JointPath) -> FloatArray:
        quantity = (path.position, path.velocity, path.acceleration)[bound.quantity]
        return np.asarray(bound.factor * (quantity[bound.joint] - bound.middle))
