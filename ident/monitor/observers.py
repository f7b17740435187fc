"""Observers of the external torque: what is left of a noisy torque per sample period, a few periods later.

Each is a linear filter per joint, exact for a torque that is constant within a sample period h:

    momentum   generalised-momentum observer, ṙ = K·(τ_ext − r) (De Luca et al., IROS 2006);
    direct     the direct residual through two equal low-passes with the same delay, 1/K;
    kalman     disturbance observer: momentum with a torque that walks at random, in its steady state, which sets the
               noise of the positions against that of the torques (Wahrburg et al., "Motor-current-based estimation of
               Cartesian contact forces and torques for robotic manipulators", IEEE T-ASE 2018).
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from drivers.core.arrays import BoolArray, FloatArray
from ident.monitor.choices import Kind

SHORT = 16
"""Samples up to which a batch is filtered by one matrix product: SciPy's filter takes longer to begin with."""


class Observer:
    """Filters external torques (N, n) of sample periods, in any division into batches.

    Args:
        numerator, denominator: (n, 3) of each joint's filter in z⁻¹.

    Attributes:
        output: (n,) the newest filtered torque [N·m or N].
    """

    def __init__(self, numerator: FloatArray, denominator: FloatArray) -> None:
        self._numerator, self._denominator = numerator, denominator
        self._alike = bool(np.all(numerator == numerator[0]) and np.all(denominator == denominator[0]))
        self._state = np.zeros((2, len(numerator)))
        self._steps: dict[int, FloatArray] = {}
        self.output = np.zeros(len(numerator))

    def apply(self, external: FloatArray, restarted: BoolArray) -> FloatArray:
        """Filtered torques (N, n) [N·m or N]; from rest where the observer is `restarted` (N,)."""
        from scipy.signal import lfilter  # here, since every command reads this module's options

        result = np.empty_like(external)
        edges = [0, *restarted.nonzero()[0].tolist(), len(external)]
        for start, stop in pairwise(edges):
            if start == stop:
                continue
            if restarted[start]:
                self._state[:] = 0.0
            batch = external[start:stop]
            if self._alike:
                b, a = self._numerator[0], self._denominator[0]
                if len(batch) > SHORT:
                    result[start:stop], self._state = lfilter(b, a, batch, axis=0, zi=self._state)
                    continue
                if (step := self._steps.get(len(batch))) is None:
                    unit = np.eye(len(batch) + 2)
                    step = np.concatenate(lfilter(b, a, unit[:-2], axis=0, zi=unit[-2:]))
                    self._steps[len(batch)] = step
                both = step @ np.concatenate([batch, self._state])
                result[start:stop], self._state = both[: len(batch)], both[len(batch) :]
                continue
            for joint, (b, a) in enumerate(zip(self._numerator, self._denominator, strict=True)):
                result[start:stop, joint], self._state[:, joint] = lfilter(
                    b, a, batch[:, joint], zi=self._state[:, joint]
                )
        if len(result):
            self.output = result[-1]
        return result


def observer(
    kind: Kind,
    period: float,
    joints: int,
    bandwidth: float,
    momentum_noise: FloatArray | None = None,
    torque_noise: FloatArray | None = None,
) -> Observer:
    """An observer at rest.

    Args:
        kind: which.
        period: h between two samples [s].
        joints: n.
        bandwidth: K [1/s].
        momentum_noise: (n,) standard deviation of the momentum by the encoders' steps, for `kalman` [N·m·s or N·s].
        torque_noise: (n,) standard deviation of a sample of the torque, for `kalman` [N·m or N].
    """
    if kind == "kalman":
        noises = (np.zeros(joints) if noise is None else noise for noise in (momentum_noise, torque_noise))
        pairs = [_kalman(period, bandwidth, *noise) for noise in zip(*noises, strict=True)]
        return Observer(np.array([b for b, _ in pairs]), np.array([a for _, a in pairs]))
    if kind == "momentum":
        decay = np.exp(-bandwidth * period)
        b, a = [1.0 - decay, 0.0, 0.0], [1.0, -decay, 0.0]
    else:
        turned = 2.0 * bandwidth * period
        decay = np.exp(-turned)
        b = [1.0 - decay * (1.0 + turned), decay * (decay + turned - 1.0), 0.0]
        a = [1.0, -2.0 * decay, decay**2]
    return Observer(np.tile(b, (joints, 1)), np.tile(a, (joints, 1)))


def _kalman(period: float, bandwidth: float, momentum_noise: float, torque_noise: float) -> tuple[FloatArray, ...]:
    """Numerator and denominator (3,) of the steady-state filter of one joint.

    The state is the momentum p and the disturbance d; p⁺ = p + h·(u + d + noise), y = p + noise. The disturbance walks
    so fast that without noise of the momentum the filter's bandwidth is K.
    """
    from scipy.linalg import solve_discrete_are

    torque = max(float(torque_noise), 1e-9)
    transition = np.array([[1.0, period], [0.0, 1.0]])
    process = np.diag([(period * torque) ** 2, (bandwidth * period * torque) ** 2])
    measurement = np.array([[max(float(momentum_noise), 1e-3 * period * torque) ** 2]])
    read = np.array([[1.0, 0.0]])
    scale = (period * torque) ** 2  # the Riccati equation's solver wants numbers near 1
    change = np.diag([1.0, 1.0 / period])  # disturbance in units of momentum per period
    covariance = solve_discrete_are(
        (np.linalg.inv(change) @ transition @ change).T,
        read.T,
        np.linalg.inv(change) @ process @ np.linalg.inv(change).T / scale,
        measurement / scale,
    )
    gain = covariance[:, 0] / (covariance[0, 0] + measurement[0, 0] / scale)
    first, second = float(gain[0]), float(gain[1]) / period
    # Innovation error s and disturbance d, driven by the external torque e of a period:
    # ν = h·(e − d) + s, s⁺ = (1 − l₁)·ν, d⁺ = d + l₂·ν.
    matrix = np.array([[1.0 - first, -(1.0 - first) * period], [second, 1.0 - second * period]])
    drive = np.array([(1.0 - first) * period, second * period])
    trace, determinant = float(np.trace(matrix)), float(np.linalg.det(matrix))
    direct = drive[1]
    lagged = matrix[1, 0] * drive[0] - matrix[0, 0] * drive[1]
    return np.array([direct, lagged, 0.0]), np.array([1.0, -trace, determinant])
