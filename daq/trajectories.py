"""Motions given by formulas: position, velocity and acceleration at any time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class FourierSeries:
    """A periodic motion, a finite Fourier series of order H for every joint (ROCR6 eq. 21).

    q_i(t) = offset_i + Σ_l (sine_il/(ω l) · sin(ω l t) − cosine_il/(ω l) · cos(ω l t)), ω = 2π/period.

    Attributes:
        period: [s].
        offset: (n,) [rad or m].
        sine: (n, H) velocity amplitudes [rad/s or m/s].
        cosine: (n, H) velocity amplitudes [rad/s or m/s].
    """

    period: float
    offset: FloatArray
    sine: FloatArray
    cosine: FloatArray

    def evaluate(self, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position, velocity, acceleration (n, N) at times (N,) [s] (ROCR6 eq. 21-23)."""
        harmonics = 2.0 * np.pi / self.period * np.arange(1, self.sine.shape[1] + 1)
        angles = np.outer(harmonics, time)
        sines, cosines = np.sin(angles), np.cos(angles)
        position = self.offset[:, None] + (self.sine / harmonics) @ sines - (self.cosine / harmonics) @ cosines
        velocity = self.sine @ cosines + self.cosine @ sines
        acceleration = (self.cosine * harmonics) @ cosines - (self.sine * harmonics) @ sines
        return position, velocity, acceleration
