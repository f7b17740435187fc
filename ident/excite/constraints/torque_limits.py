"""Constraint of an excitation: the torque that the motion needs, by parameters known beforehand (AUBO eq. 21)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daq.robot.schema import JointLimits
from drivers.core.arrays import FloatArray
from drivers.core.text import percent_text
from ident.excite.constraints.soft_maximum import soft_maximum
from ident.excite.path import JointPath
from ident.model.dynamic_model import DynamicModel
from ident.model.regressor import SAMPLES_AT_ONCE, RegressorKernel, model_torque
from ident.model.regressor_gradient import pull_back_regressor


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


TORQUE_SHARE = 0.85
"""Share of a torque limit that a design may use: the prior is rough, and a supervisor checks noisy torque."""
_NEGLIGIBLE_SHARE = 1e-12
"""Samples whose torque moves the soft maximum by less than this of its change are left out of the derivative."""


class TorqueLimits:
    """|τ_j| over `TORQUE_SHARE` of each known torque limit, with τ = Y·π on chosen standard columns.

    The sign of a velocity counts as constant where the model's Coulomb friction is not smooth.
    """

    def __init__(self, model: DynamicModel, columns: Sequence[int], parameters: FloatArray) -> None:
        """Prepare for an arm.

        Args:
            model: the arm.
            columns: standard columns (b,), as those of its base parameters.
            parameters: (b,), their values [SI].

        Raises:
            ValueError: not one finite parameter a column.
        """
        if np.shape(parameters) != (len(columns),) or not np.all(np.isfinite(parameters)):
            raise ValueError(f"{len(columns)} columns need as many finite parameters")
        self._model = model
        self._columns = tuple(columns)
        self._parameters = np.array(parameters, dtype=np.float64)
        limited = [(joint, limits.torque) for joint, limits in enumerate(model.limits) if limits.torque is not None]
        self._joints = [joint for joint, torque in limited if np.isfinite(torque)]
        self._limits = TORQUE_SHARE * np.array([torque for _, torque in limited if np.isfinite(torque)])
        self._kernel = RegressorKernel(model, columns)
        # Of each packed row, how much it adds to the use of each limited joint.
        self._shares = np.zeros((self._kernel.row_count, len(self._joints)))
        for row, joint in enumerate(self._joints):
            rows = self._kernel.joint_rows[joint]
            self._shares[rows.rows, row] = self._parameters[list(rows.columns)] / self._limits[row]

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints whose torque is limited."""
        return tuple(self._model.limits[joint].name for joint in self._joints)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the limits, such as `torque of elbow (85 % of its limit)`."""
        return tuple(f"torque of {name} ({percent_text(TORQUE_SHARE)} of its limit)" for name in self.joint_names)

    def use(self, path: JointPath) -> FloatArray:
        """(m,) largest use on the grid."""
        return np.asarray(np.abs(self.use_over_time(path)).max(axis=1))

    def smooth_use(self, path: JointPath, sharpness: float) -> tuple[FloatArray, FloatArray]:
        """Smooth upper bound (m,) and its derivatives (m, 3, n, N)."""
        used = self.use_over_time(path)
        bounds, weights = soft_maximum(np.concatenate([used, -used], axis=1), sharpness)
        count = path.time.size
        return bounds, self._pull_back(path, weights[:, :count] - weights[:, count:])

    def use_over_time(self, path: JointPath) -> FloatArray:
        """Signed torque over `TORQUE_SHARE` of its limit (m, N)."""
        motion = (path.position, path.velocity, path.acceleration)
        torque = model_torque(self._model, self._columns, self._parameters, *motion)
        return np.asarray(torque[self._joints] / self._limits[:, None])

    def _pull_back(self, path: JointPath, by_torque: FloatArray) -> FloatArray:
        """(m, 3, n, N) from derivatives (m, N) by the torques over their limits.

        Only the torques that count go through the recursion, one after the other as if they were samples.
        """
        gradient = np.zeros((len(self._joints), 3, *path.position.shape))
        rows, samples = np.nonzero(np.abs(by_torque) > _NEGLIGIBLE_SHARE)
        for start in range(0, len(rows), SAMPLES_AT_ONCE):
            row, sample = rows[start : start + SAMPLES_AT_ONCE], samples[start : start + SAMPLES_AT_ONCE]
            position, velocity, acceleration = (
                np.ascontiguousarray(of[:, sample]) for of in (path.position, path.velocity, path.acceleration)
            )
            weights = self._shares[:, row] * by_torque[row, sample]
            self._kernel.evaluate(position, velocity, acceleration, np.empty_like(weights))
            pulled = pull_back_regressor(self._kernel, position, velocity, acceleration, weights)
            gradient[row, :, :, sample] = pulled.transpose(2, 0, 1)
        return gradient
