"""Motions given by formulas: position, velocity and acceleration at any time, and where their extremes lie."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, Self

import numpy as np

from daq.robot.schema import JointLimits
from drivers.errors import UsageError
from drivers.streams import FloatArray

GRID_RATE = 1000.0
"""Limits are checked on a grid of at least this many points per second [Hz], and where the extremes lie."""
LIMIT_TOLERANCE = 1e-9
QUINTIC_VELOCITY = 15.0 / 8.0
"""Largest velocity of a fifth-order move of length 1 in time 1."""
QUINTIC_ACCELERATION = 10.0 / np.sqrt(3.0)
"""Its largest acceleration."""
_NEGLIGIBLE = 1e-14
"""Share of the largest coefficient below which a harmonic does not move a zero, but would be divided by."""
_MAX_GRID = 2_000_000


class Motion(Protocol):
    """What can be played: a path in joint space over time."""

    @property
    def duration(self) -> float:
        """[s]; one period where the motion repeats."""

    def evaluate(self, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position, velocity, acceleration (n, N) at times (N,) [s]."""

    def extreme_times(self) -> FloatArray:
        """Times [s] at which the formula has its extremes; empty where only a grid finds them."""


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
        harmonics = 2.0 * np.pi / self.period * np.arange(1, self.sine.shape[1] + 1)
        angles = np.outer(harmonics, time)
        sines, cosines = np.sin(angles), np.cos(angles)
        position = self.offset[:, None] + (self.sine / harmonics) @ sines - (self.cosine / harmonics) @ cosines
        velocity = self.sine @ cosines + self.cosine @ sines
        acceleration = (self.cosine * harmonics) @ cosines - (self.sine * harmonics) @ sines
        return position, velocity, acceleration

    def extreme_times(self) -> FloatArray:
        """Times [s] within one period at which position, velocity or acceleration of some joint is extreme.

        They are the zeros of q̇, q̈ and the jerk, trigonometric polynomials of degree H: with z = exp(iωt), the roots
        on the unit circle of a polynomial of degree 2H.
        """
        order = np.arange(1, self.sine.shape[1] + 1)
        harmonics = 2.0 * np.pi / self.period * order
        times: list[FloatArray] = []
        for sine, cosine in zip(self.sine, self.cosine, strict=True):
            # d/dt maps (a cos + b sin) to (lω b cos − lω a sin).
            of_cos, of_sin = sine, cosine
            for _ in range(3):
                times.append(_trigonometric_zeros(of_cos, of_sin) * self.period / (2.0 * np.pi))
                of_cos, of_sin = harmonics * of_sin, -harmonics * of_cos
        return np.unique(np.concatenate(times))


def _trigonometric_zeros(of_cos: FloatArray, of_sin: FloatArray) -> FloatArray:
    """Angles in [0, 2π) at which Σ_l (of_cos_l cos(lφ) + of_sin_l sin(lφ)) vanishes."""
    scale = float(np.max(np.abs([of_cos, of_sin]), initial=0.0))
    if scale == 0.0:
        return np.zeros(0)
    positive = 0.5 * (of_cos - 1j * of_sin) / scale  # coefficient of z^l; of z^-l its conjugate
    positive[np.abs(positive) < _NEGLIGIBLE] = 0.0
    roots = np.roots(np.concatenate([positive[::-1], [0.0], np.conj(positive)]))
    # Double zeros leave the circle by the square root of the rounding error; a few points too many do no harm.
    near = roots[np.abs(np.abs(roots) - 1.0) < 1e-4]
    return np.asarray(np.mod(np.angle(near), 2.0 * np.pi))


@dataclass(frozen=True)
class SumOfSines:
    """q_i(t) = offset_i + Σ_k amplitude_ik sin(frequency_ik t), for `duration` (UP6 eq. 8).

    Attributes:
        duration: [s].
        offset: (n,) [rad or m].
        amplitude: (n, K) [rad or m].
        frequency: (n, K) angular [rad/s].
    """

    duration: float
    offset: FloatArray
    amplitude: FloatArray
    frequency: FloatArray

    def evaluate(self, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position, velocity, acceleration (n, N) at times (N,) [s]."""
        angles = self.frequency[:, :, None] * time
        sines, cosines = np.sin(angles), np.cos(angles)
        position = self.offset[:, None] + np.einsum("nk,nkt->nt", self.amplitude, sines)
        velocity = np.einsum("nk,nkt->nt", self.amplitude * self.frequency, cosines)
        acceleration = -np.einsum("nk,nkt->nt", self.amplitude * self.frequency**2, sines)
        return position, velocity, acceleration

    def extreme_times(self) -> FloatArray:
        """None: frequencies without a common period have no closed form; the grid finds the extremes."""
        return np.zeros(0)


@dataclass(frozen=True)
class PointToPoint:
    """From point to point by fifth-order polynomials, at rest in each (SR400 .4.3).

    Between points a and b, with u = t/T: q = a + (b − a)(10u³ − 15u⁴ + 6u⁵); then it waits for `dwell`.

    Attributes:
        points: (P, n) [rad or m], P at least 2.
        durations: (P−1,) of the moves [s].
        dwell: rest in every point but the first [s].
    """

    points: FloatArray
    durations: FloatArray
    dwell: float = 0.0

    @cached_property
    def _starts(self) -> FloatArray:
        return np.concatenate([[0.0], np.cumsum(self.durations + self.dwell)])

    @property
    def duration(self) -> float:
        """Of all moves and rests [s]."""
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

    def extreme_times(self) -> FloatArray:
        """Ends, middle (velocity) and u = (3 ± √3)/6 (acceleration) of every move [s]."""
        shares = np.array([0.0, (3.0 - np.sqrt(3.0)) / 6.0, 0.5, (3.0 + np.sqrt(3.0)) / 6.0, 1.0])
        return np.asarray((self._starts[:-1, None] + self.durations[:, None] * shares).ravel())


class SampledMotion:
    """A cubic spline through samples, at rest at both ends.

    Args:
        time: (N,) [s], rising from 0.
        position: (n, N) [rad or m].
    """

    def __init__(self, time: FloatArray, position: FloatArray) -> None:
        from scipy.interpolate import CubicSpline

        self._position = CubicSpline(time, position, axis=1, bc_type="clamped")
        self._velocity = self._position.derivative(1)
        self._acceleration = self._position.derivative(2)
        self.duration = float(time[-1])

    def evaluate(self, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position, velocity, acceleration (n, N) at times (N,) [s]; held at the ends."""
        inside = np.clip(time, 0.0, self.duration)
        moving = (time >= 0.0) & (time <= self.duration)
        return (
            np.asarray(self._position(inside)),
            np.asarray(self._velocity(inside)) * moving,
            np.asarray(self._acceleration(inside)) * moving,
        )

    def extreme_times(self) -> FloatArray:
        """The knots, where the acceleration is extreme, and the zeros of velocity and acceleration [s]."""
        knots = np.asarray(self._position.x, dtype=np.float64)
        width = np.diff(knots)
        start, end = self._acceleration(knots[:-1]), self._acceleration(knots[1:])
        with np.errstate(divide="ignore", invalid="ignore"):
            at_zero = knots[:-1] + width * start / (start - end)
            jerk, speed = (end - start) / width, self._velocity(knots[:-1])
            root = np.sqrt(start**2 - 2.0 * jerk * speed)
            turns = [knots[:-1] + (-start + sign * root) / jerk for sign in (1.0, -1.0)]
        candidates = np.concatenate([values.ravel() for values in (at_zero, *turns)])
        candidates = candidates[np.isfinite(candidates) & (candidates > 0.0) & (candidates < self.duration)]
        return np.unique(np.concatenate([knots, candidates]))


@dataclass(frozen=True)
class RestToRest:
    """A periodic motion, repeated, that begins and ends at rest.

    Its path is not changed, only the pace: the motion's own time s runs from standstill to ṡ = 1 within `ramp`, by
    ṡ = 10u³ − 15u⁴ + 6u⁵, and back in the same way. In between it is the motion itself, exactly periodic.

    Attributes:
        motion: what is slowed at its ends.
        periods: how many times its `duration` is run at full pace.
        ramp: [s] at each end.
    """

    motion: Motion
    periods: int
    ramp: float

    @property
    def duration(self) -> float:
        """Of the ramps and the periods [s]."""
        return self.periods * self.motion.duration + 2.0 * self.ramp

    def evaluate(self, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position, velocity, acceleration (n, N) at times (N,) [s]; at rest before and after."""
        time = np.clip(time, 0.0, self.duration)
        from_end = np.minimum(time, self.duration - time)
        u = np.clip(from_end / self.ramp, 0.0, 1.0)
        pace = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
        pace_change = 30.0 * u**2 * (1.0 - u) ** 2 / self.ramp
        pace_change = np.where(time < 0.5 * self.duration, pace_change, -pace_change)
        # ∫ṡ over a whole ramp is half of it, so full pace begins at s = 0.
        behind = self.ramp * (u**4 * (2.5 - 3.0 * u + u**2) - 0.5)
        length = self.periods * self.motion.duration
        own = np.where(time <= self.ramp, behind, np.where(from_end < self.ramp, length - behind, time - self.ramp))
        position, velocity, acceleration = self.motion.evaluate(own)
        return position, velocity * pace, acceleration * pace**2 + velocity * pace_change

    def extreme_times(self) -> FloatArray:
        """Those of the motion at full pace [s]; in the ramps the grid finds them."""
        inner = self.motion.extreme_times()
        starts = self.ramp + self.motion.duration * np.arange(self.periods)
        return np.concatenate([[0.0, self.duration], (starts[:, None] + inner).ravel()])


@dataclass(frozen=True)
class Extremes:
    """The largest values of a motion, a value a joint.

    Attributes:
        lowest, highest: position [rad or m].
        velocity, acceleration: magnitude.
        times: (4, n) when each of the four is reached [s].
    """

    lowest: FloatArray
    highest: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    times: FloatArray


def motion_extremes(motion: Motion) -> Extremes:
    """The extremes of a motion over its duration, on a grid of at least 1 kHz and at the formula's own."""
    count = int(min(max(motion.duration * GRID_RATE, 2000.0), _MAX_GRID)) + 1
    time = np.unique(np.concatenate([np.linspace(0.0, motion.duration, count), motion.extreme_times()]))
    position, velocity, acceleration = motion.evaluate(time)
    extremes = (position.argmin(1), position.argmax(1), np.abs(velocity).argmax(1), np.abs(acceleration).argmax(1))
    rows = np.arange(len(position))
    return Extremes(
        position[rows, extremes[0]],
        position[rows, extremes[1]],
        np.abs(velocity[rows, extremes[2]]),
        np.abs(acceleration[rows, extremes[3]]),
        time[np.array(extremes)],
    )


def check_limits(motion: Motion, limits: Sequence[JointLimits], where: str) -> None:
    """Refuse a motion that leaves a joint's range or exceeds its velocity or acceleration limit.

    Raises:
        UsageError: names the joint, the value, the limit and the time.
    """
    extremes = motion_extremes(motion)
    if len(extremes.lowest) != len(limits):
        raise UsageError(f"moves {len(extremes.lowest)} joints, but the robot has {len(limits)}", where=where)
    for joint, limit in enumerate(limits):
        low, high = limit.position
        cases = (
            ("position", "rad or m", -extremes.lowest[joint], -low, -1.0),
            ("position", "rad or m", extremes.highest[joint], high, 1.0),
            ("velocity", "rad/s or m/s", extremes.velocity[joint], limit.velocity, 1.0),
            ("acceleration", "rad/s² or m/s²", extremes.acceleration[joint], limit.acceleration, 1.0),
        )
        for case, (quantity, unit, value, allowed, sign) in enumerate(cases):
            if not value <= allowed + LIMIT_TOLERANCE * max(1.0, abs(allowed)):
                raise UsageError(
                    f"joint {limit.name}: {quantity} {sign * value:.5g} at {extremes.times[case, joint]:.3f} s "
                    f"passes its limit of {sign * allowed:.5g} {unit}",
                    where=where,
                    hint="reduce the amplitude or slow the motion down",
                )


def check_rest(motion: Motion, limits: Sequence[JointLimits], where: str) -> None:
    """Refuse a motion that does not begin and end at rest (velocity below 0.1 % of the limit).

    Raises:
        UsageError: names the joint and the velocity.
    """
    _, velocity, _ = motion.evaluate(np.array([0.0, motion.duration]))
    for joint, limit in enumerate(limits):
        for moment, value in zip(("begins", "ends"), velocity[joint], strict=True):
            if not abs(value) <= 1e-3 * limit.velocity:
                raise UsageError(f"{moment} with joint {limit.name} at {value:.4g} rad/s, not at rest", where=where)


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
