"""Motions given by formulas: position, velocity and acceleration at any time, and bounds of their derivatives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, Self

import numpy as np

from daq.robot.schema import JointLimits
from drivers.core.arrays import FloatArray

SHORTEST_RAMP = 0.1
"""Shortest time from rest to full speed that a motion may have [s]; no arm's position loop settles much faster."""
QUINTIC_VELOCITY = 15.0 / 8.0
"""Largest velocity of a fifth-order move of length 1 in time 1."""
QUINTIC_ACCELERATION = 10.0 / np.sqrt(3.0)
"""Its largest acceleration."""
_JERK, _SNAP = 60.0, 360.0
"""Its largest third and fourth derivative."""


@dataclass(frozen=True)
class Pieces:
    """Parts of a motion, in each of which its formula is smooth, with bounds that hold everywhere within.

    Together they contain every value that the motion takes; of a part that is repeated there is one.
    """

    # start, end: (M,) [s]
    start: FloatArray
    end: FloatArray
    # (4, n, M) at least the magnitude of velocity, acceleration, jerk and its derivative [rad/s, … rad/s⁴]
    largest: FloatArray


class Motion(Protocol):
    """What can be played: a path in joint space over time."""

    @property
    def duration(self) -> float:
        """[s]; one period where the motion repeats."""

    def evaluate(self, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position, velocity, acceleration (n, N) at times (N,) [s]."""

    def pieces(self) -> Pieces:
        """Its smooth parts, with bounds of its derivatives; `daq.motion.limits` encloses its extremes by them."""


def sampled(motion: Motion, rate: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times (N,) from the start [s], positions and velocities (N, n), at `rate` [Hz], none after the motion's end."""
    time = np.arange(int(motion.duration * rate + 1e-6) + 1) / rate
    position, velocity, _ = motion.evaluate(time)
    return time, np.ascontiguousarray(position.T), np.ascontiguousarray(velocity.T)


class Oscillation(Motion, Protocol):
    """A motion that goes on before 0 and after `duration`."""

    def largest_derivatives(self) -> FloatArray:
        """(4, n) as `Pieces.largest`, at any time."""


_AT_ONCE = 500_000
"""Sines that are evaluated at once; four arrays of them take 16 MB."""


def _in_parts(
    evaluate: Callable[[FloatArray], tuple[FloatArray, FloatArray, FloatArray]],
    time: FloatArray,
    joints: int,
    sines: int,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position, velocity, acceleration (joints, N) of a sum of so many sines in all, at times (N,), part by part."""
    step = max(1, _AT_ONCE // max(sines, 1))
    if len(time) <= step:
        return evaluate(time)
    whole = np.empty((3, joints, len(time)))
    for start in range(0, len(time), step):
        whole[:, :, start : start + step] = evaluate(time[start : start + step])
    return whole[0], whole[1], whole[2]


@dataclass(frozen=True)
class FourierSeries:
    """A periodic motion, a finite Fourier series of order H for every joint (ROCR6 eq. 21).

    q_i(t) = offset_i + Σ_l (sine_il/(ω l) · sin(ω l t) − cosine_il/(ω l) · cos(ω l t)), ω = 2π/period.
    """

    period: float  # [s]
    offset: FloatArray  # (n,) [rad or m]
    sine: FloatArray  # (n, H) velocity amplitudes [rad/s or m/s]
    cosine: FloatArray  # (n, H) velocity amplitudes [rad/s or m/s]

    @classmethod
    def from_position_amplitudes(cls, period: float, offset: FloatArray, sine: FloatArray, cosine: FloatArray) -> Self:
        """The series q_i0 + Σ_k (a_ik sin(k ω t) + b_ik cos(k ω t)) with amplitudes (n, H) [rad or m] (AUBO eq. 20)."""
        harmonics = 2.0 * np.pi / period * np.arange(1, sine.shape[1] + 1)
        return cls(period, offset, sine * harmonics, -cosine * harmonics)

    @property
    def duration(self) -> float:
        """One period [s]."""
        return self.period

    def evaluate(self, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position, velocity, acceleration (n, N) at times (N,) [s] (ROCR6 eq. 21-23)."""
        return _in_parts(self._evaluate, time, *self.sine.shape)

    def _evaluate(self, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        harmonics = 2.0 * np.pi / self.period * np.arange(1, self.sine.shape[1] + 1)
        angles = np.outer(harmonics, time)
        sines, cosines = np.sin(angles), np.cos(angles)
        position = self.offset[:, None] + (self.sine / harmonics) @ sines - (self.cosine / harmonics) @ cosines
        velocity = self.sine @ cosines + self.cosine @ sines
        acceleration = (self.cosine * harmonics) @ cosines - (self.sine * harmonics) @ sines
        return position, velocity, acceleration

    def largest_derivatives(self) -> FloatArray:
        """(4, n) the sums of the harmonics' amplitudes."""
        harmonics = 2.0 * np.pi / self.period * np.arange(1, self.sine.shape[1] + 1)
        return _sums_of_powers(np.hypot(self.sine, self.cosine) / harmonics, harmonics)

    def pieces(self) -> Pieces:
        """One period."""
        return Pieces(np.zeros(1), np.array([self.period]), self.largest_derivatives()[:, :, None])


def _sums_of_powers(amplitude: FloatArray, frequency: FloatArray) -> FloatArray:
    """(4, n) sums over the columns of amplitude · frequency^k, k = 1 … 4."""
    return np.array([(amplitude * frequency**power).sum(axis=-1) for power in (1, 2, 3, 4)])


@dataclass(frozen=True)
class SumOfSines:
    """q_i(t) = offset_i + Σ_k amplitude_ik sin(frequency_ik t), for `duration` (UP6 eq. 8)."""

    duration: float  # [s]
    offset: FloatArray  # (n,) [rad or m]
    amplitude: FloatArray  # (n, K) [rad or m]
    frequency: FloatArray  # (n, K) angular [rad/s]

    def evaluate(self, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position, velocity, acceleration (n, N) at times (N,) [s]."""
        return _in_parts(self._evaluate, time, len(self.amplitude), self.amplitude.size)

    def _evaluate(self, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        angles = self.frequency[:, :, None] * time
        sines, cosines = np.sin(angles), np.cos(angles)
        position = self.offset[:, None] + np.einsum("nk,nkt->nt", self.amplitude, sines)
        velocity = np.einsum("nk,nkt->nt", self.amplitude * self.frequency, cosines)
        acceleration = -np.einsum("nk,nkt->nt", self.amplitude * self.frequency**2, sines)
        return position, velocity, acceleration

    def largest_derivatives(self) -> FloatArray:
        """(4, n) the sums of the sines' amplitudes."""
        return _sums_of_powers(np.abs(self.amplitude), np.abs(self.frequency))

    def pieces(self) -> Pieces:
        """All of it."""
        return Pieces(np.zeros(1), np.array([self.duration]), self.largest_derivatives()[:, :, None])


@dataclass(frozen=True)
class PointToPoint:
    """Moves from point to point by fifth-order polynomials, at rest in each (SR400 .4.3).

    Between points a and b, with u = t/T: q = a + (b − a)(10u³ − 15u⁴ + 6u⁵); then it waits for `dwell`.
    """

    points: FloatArray  # (P, n) [rad or m], P at least 2
    durations: FloatArray  # (P−1,) of the moves [s]
    dwell: float = 0.0  # rest in every point but the first [s]

    @cached_property
    def _starts(self) -> FloatArray:
        return np.concatenate([[0.0], np.cumsum(self.durations + self.dwell)])

    @property
    def duration(self) -> float:
        """Duration of all moves and rests [s]."""
        return float(self._starts[-1])

    def evaluate(self, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position, velocity, acceleration (n, N) at times (N,) [s]; at rest before and after."""
        move = np.clip(np.searchsorted(self._starts, time, side="right") - 1, 0, len(self.durations) - 1)
        length = self.durations[move]
        u = np.clip((time - self._starts[move]) / length, 0.0, 1.0)
        start, way = self.points[move].T, (self.points[move + 1] - self.points[move]).T
        position = start + way * (u**3 * (10.0 - 15.0 * u + 6.0 * u**2))
        velocity = way * (30.0 * u**2 * (1.0 - u) ** 2) / length
        acceleration = way * (60.0 * u * (1.0 - u) * (1.0 - 2.0 * u)) / length**2
        return position, velocity, acceleration

    def pieces(self) -> Pieces:
        """Return its moves; the rests have no further values."""
        way = np.abs(np.diff(self.points, axis=0).T)
        factors = (QUINTIC_VELOCITY, QUINTIC_ACCELERATION, _JERK, _SNAP)
        largest = [factor * way / self.durations**power for power, factor in enumerate(factors, start=1)]
        return Pieces(self._starts[:-1], self._starts[:-1] + self.durations, np.array(largest))


class SampledMotion:
    """A cubic spline through samples (n, N) [rad or m] at times (N,) [s] that rise from 0, at rest at both ends."""

    def __init__(self, time: FloatArray, position: FloatArray) -> None:
        from scipy.interpolate import CubicSpline

        self._position = CubicSpline(time, position, axis=1, bc_type="clamped")
        self._velocity = self._position.derivative(1)
        self._acceleration = self._position.derivative(2)
        self.duration = float(time[-1])

    def evaluate(self, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position, velocity, acceleration (n, N) at times (N,) [s]; held at the ends."""
        inside = np.clip(time, 0.0, self.duration)
        # A time that was scaled may miss the end by its rounding, and there the acceleration is not 0.
        moving = (time >= 0.0) & (time <= self.duration * (1.0 + 1e-12))
        return (
            np.asarray(self._position(inside)),
            np.asarray(self._velocity(inside)) * moving,
            np.asarray(self._acceleration(inside)) * moving,
        )

    def pieces(self) -> Pieces:
        """The pieces between knots, in which the jerk is constant."""
        knots = np.asarray(self._position.x, dtype=np.float64)
        velocity, acceleration = self._velocity(knots), np.abs(self._acceleration(knots))
        jerk = np.abs(np.diff(self._acceleration(knots), axis=1)) / np.diff(knots)
        fastest = np.maximum(acceleration[:, :-1], acceleration[:, 1:])
        speed = np.abs(velocity[:, :-1]) + fastest * np.diff(knots)
        return Pieces(knots[:-1], knots[1:], np.array([speed, fastest, jerk, np.zeros_like(jerk)]))


def quintic_pace(since: FloatArray, ramp: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A path's own time, its pace and the pace's rate of change (N,) on the way from standstill to full pace.

    ṡ = 10u³ − 15u⁴ + 6u⁵ with u = t/ramp and t (N,) since the standstill [s]; after the ramp [s], the values at its
    end.
    """
    u = np.clip(since / ramp, 0.0, 1.0)
    risen = ramp * (u**4 * (2.5 - 3.0 * u + u**2))
    return risen, u**3 * (10.0 - 15.0 * u + 6.0 * u**2), 30.0 * u**2 * (1.0 - u) ** 2 / ramp


@dataclass(frozen=True)
class RestToRest:
    """A periodic motion, repeated, that begins and ends at rest.

    Its path is not changed, only the pace: the motion's own time s runs from standstill to ṡ = 1 within `ramp`, by
    ṡ = 10u³ − 15u⁴ + 6u⁵, and back in the same way. In between it is the motion itself, exactly periodic.
    """

    motion: Oscillation  # what is slowed at its ends
    periods: int  # how many times its `duration` is run at full pace
    ramp: float  # [s] at each end

    @property
    def duration(self) -> float:
        """Duration of the ramps and the periods [s]."""
        return self.periods * self.motion.duration + 2.0 * self.ramp

    def evaluate(self, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position, velocity, acceleration (n, N) at times (N,) [s]; at rest before and after."""
        time = np.clip(time, 0.0, self.duration)
        from_end = np.minimum(time, self.duration - time)
        risen, pace, pace_change = quintic_pace(from_end, self.ramp)
        pace_change = np.where(time < 0.5 * self.duration, pace_change, -pace_change)
        # ∫ṡ over a whole ramp is half of it, so full pace begins at s = 0.
        behind = risen - 0.5 * self.ramp
        length = self.periods * self.motion.duration
        own = np.where(time <= self.ramp, behind, np.where(from_end < self.ramp, length - behind, time - self.ramp))
        position, velocity, acceleration = self.motion.evaluate(own)
        return position, velocity * pace, acceleration * pace**2 + velocity * pace_change

    def pieces(self) -> Pieces:
        """The ramps, where the chain rule gives the derivatives of position by time, and one period between them."""
        own = self.motion.largest_derivatives()
        rates = (QUINTIC_VELOCITY, QUINTIC_ACCELERATION, _JERK)
        a, b, c = (rate / self.ramp**power for power, rate in enumerate(rates, start=1))
        ramp = np.array(
            [
                own[0],
                own[1] + own[0] * a,
                own[2] + 3.0 * own[1] * a + own[0] * b,
                own[3] + 6.0 * own[2] * a + own[1] * (3.0 * a**2 + 4.0 * b) + own[0] * c,
            ]
        )
        begin, length = np.array([0.0, self.ramp, self.duration - self.ramp]), self.motion.duration
        end = np.array([self.ramp, self.ramp + length, self.duration])
        return Pieces(begin, end, np.stack([ramp, own, ramp], axis=-1))


def slow_move(start: FloatArray, end: FloatArray, limits: Sequence[JointLimits], share: float = 0.1) -> PointToPoint:
    """A quintic from `start` to `end` (n,) that uses at most `share` of every velocity and acceleration limit.

    The extremes of the quintic over time T are `QUINTIC_VELOCITY`·D/T and `QUINTIC_ACCELERATION`·D/T².
    """
    way = np.abs(end - start)
    velocity = share * np.array([limit.velocity for limit in limits])
    acceleration = share * np.array([limit.acceleration for limit in limits])
    by_velocity = float(np.max(QUINTIC_VELOCITY * way / velocity))
    by_acceleration = float(np.max(np.sqrt(QUINTIC_ACCELERATION * way / acceleration)))
    duration = max(by_velocity, by_acceleration, 0.1)
    return PointToPoint(np.array([start, end]), np.array([duration]))
