"""A Fourier series that a fifth-order polynomial brings to rest at both ends of its period."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daq.motion.trajectories import QUINTIC_ACCELERATION, FourierSeries, Pieces
from drivers.core.arrays import FloatArray

_LARGEST = ((1.0, np.sqrt(3.0) / 18.0), (QUINTIC_ACCELERATION, 1.0), (60.0, 6.0), (360.0, 12.0))
"""Largest magnitudes of the first to fourth derivative of u − 10u³ + 15u⁴ − 6u⁵ and of u²(1 − u)²/2."""


@dataclass(frozen=True)
class FourierQuintic:
    """A modified Fourier series (as in UP6 .4.1, references 14 and 15): every period begins and ends at rest.

    q_i(t) = offset_i + f_i(t) + p_i(t), where f_i is the sum of ROCR6 eq. 21 and p_i the only polynomial of fifth order
    that vanishes at both ends of the period and there has the opposite velocity and acceleration of f_i. With u =
    t/period, f'(0) = Σ sine_l and f''(0) = Σ ω l cosine_l it is

    p(t) = −f'(0)·period·(u − 10u³ + 15u⁴ − 6u⁵) − f''(0)·period²·u²(1 − u)²/2.

    So position, velocity and acceleration are continuous where periods meet; the jerk is not.
    """

    period: float  # [s]
    offset: FloatArray  # (n,) [rad or m]
    sine: FloatArray  # (n, H) velocity amplitudes of the series [rad/s or m/s]
    cosine: FloatArray  # (n, H) velocity amplitudes of the series [rad/s or m/s]
    periods: int = 1  # how many follow each other

    @property
    def duration(self) -> float:
        """Duration of all periods [s]."""
        return self.periods * self.period

    def evaluate(self, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position, velocity, acceleration (n, N) at times (N,) [s]; at rest before and after."""
        # A time that is clipped lies at the end of a period, where the motion rests.
        own = np.mod(np.clip(time, 0.0, self.duration), self.period)
        position, velocity, acceleration = FourierSeries(self.period, self.offset, self.sine, self.cosine).evaluate(own)
        harmonics = 2.0 * np.pi / self.period * np.arange(1, self.sine.shape[1] + 1)
        speed, change = self.sine.sum(axis=1)[:, None], (self.cosine @ harmonics)[:, None]
        u = own / self.period
        v = 1.0 - u
        position = position - self.period * (speed * (u - u**3 * (10.0 - 15.0 * u + 6.0 * u**2)))
        position = position - 0.5 * self.period**2 * change * (u * v) ** 2
        velocity = velocity - speed * (1.0 - 30.0 * (u * v) ** 2) - self.period * change * (u * v * (1.0 - 2.0 * u))
        acceleration = acceleration + speed / self.period * (60.0 * u * v * (1.0 - 2.0 * u))
        acceleration = acceleration - change * (1.0 - 6.0 * u * v)
        return position, velocity, acceleration

    def pieces(self) -> Pieces:
        """One period; the bounds of series and polynomial are added."""
        series = FourierSeries(self.period, self.offset, self.sine, self.cosine).largest_derivatives()
        harmonics = 2.0 * np.pi / self.period * np.arange(1, self.sine.shape[1] + 1)
        speed, change = np.abs(self.sine.sum(axis=1)), np.abs(self.cosine @ harmonics)
        polynomial = [
            speed * of_speed / self.period**power + change * of_change / self.period ** (power - 1)
            for power, (of_speed, of_change) in enumerate(_LARGEST)
        ]
        largest = series + np.array(polynomial)
        return Pieces(np.zeros(1), np.array([self.period]), largest[:, :, None])
