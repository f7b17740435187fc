"""Fourier series as families of motions: all harmonics of one period, linear in their coefficients."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, ClassVar

import numpy as np

from daq.motion.fourier_quintic import FourierQuintic
from daq.motion.trajectories import FourierSeries, Motion, RestToRest
from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from ident.excite.families.moving_joints import Family, check_count, check_positive, check_ramp, midrange, unwrapped
from ident.excite.path import JointPath

_SCALE_POINTS = 40
"""Points in the shortest wave on which a coefficient's scale and a random motion's limit utilisation are evaluated."""
_TOLERANCE = 1e-9

Series = type[Any]


@lru_cache(maxsize=8)
def _basis(series: Series, period: float, harmonics: int, time: bytes) -> FloatArray:
    """Position, velocity and acceleration (3, 1 + 2H, N) that a single coefficient of 1 causes.

    The coefficients are the offset, the H sines and the H cosines; all motions of a period are sums of these.
    """
    alone = np.eye(1 + 2 * harmonics)
    motion = series(period, alone[:, 0], alone[:, 1 : 1 + harmonics], alone[:, 1 + harmonics :])
    basis = np.array(motion.evaluate(np.frombuffer(time)))
    basis.flags.writeable = False
    return basis


@dataclass(frozen=True, eq=False)
class _Series(Family):
    """Common base of both; x holds offset, sines and cosines of each joint that moves, one joint after another.

    The offset counts from the middle of the joint's range in halves of it. A single sine or cosine of 1 would use all
    of the tightest limit.
    """

    SERIES: ClassVar[Series]

    period: float
    harmonics: int
    periods: int

    def __post_init__(self) -> None:
        check_positive("period", self.period)
        check_count("harmonics", self.harmonics, 1)
        check_count("periods", self.periods, 1)

    @property
    def size(self) -> int:
        """Number of decision variables: 1 + 2H for each joint that moves."""
        return self.joints.count * (1 + 2 * self.harmonics)

    def grid(self, count: int) -> FloatArray:
        """`count` times (count,) [s] in one period, without its end, which is its beginning."""
        return np.linspace(0.0, self.period, max(count, 2), endpoint=False)

    def path(self, variables: FloatArray, time: FloatArray) -> JointPath:
        """One period at full speed, or any times of its continuation."""
        moved = self._coefficients(variables) @ self._at(time)
        return self.joints.path(time, *moved)

    def pull_back(self, variables: FloatArray, time: FloatArray, gradient: FloatArray) -> FloatArray:
        """Implement `Family`; the motion is linear in x, so that x itself does not matter."""
        of_moving = gradient[..., self.joints.rows, :]
        by_coefficient = (of_moving @ self._at(time).transpose(0, 2, 1)).sum(axis=-3)
        return np.asarray((by_coefficient * self._scale).reshape(*gradient.shape[:-3], self.size))

    def random(self, generator: np.random.Generator) -> FloatArray:
        """A random x within the limits (`MovingJoints.fitted`)."""
        variables = generator.normal(size=(self.joints.count, 1 + 2 * self.harmonics))
        coefficients = self._scale * variables
        coefficients[:, 0] = 0.0
        position, velocity, acceleration = coefficients @ self._own_basis
        factor, offset = self.joints.fitted(position, velocity, acceleration, generator)
        variables *= factor[:, None]
        variables[:, 0] = (offset - self.joints.middle) / self.joints.half
        return variables.ravel()

    def middle(self, variables: FloatArray) -> FloatArray:
        """Middle (m,) of the range of each moving joint's motion [rad or m]."""
        return midrange(self._coefficients(variables) @ self._own_basis[0])

    def about(self, variables: FloatArray, pose: FloatArray, share: float) -> FloatArray:
        """Implement `Family`."""
        moved = share * variables.reshape(self.joints.count, -1)
        offset = self._coefficients(variables)[:, 0]
        moved[:, 0] = (pose + share * (offset - self.middle(variables)) - self.joints.middle) / self.joints.half
        return np.asarray(moved.ravel())

    def _at(self, time: FloatArray) -> FloatArray:
        stamps = np.ascontiguousarray(time, dtype=np.float64).tobytes()
        return _basis(self.SERIES, self.period, self.harmonics, stamps)  # type: ignore[arg-type]  # a class has a hash

    @cached_property
    def _own_basis(self) -> FloatArray:
        return self._at(self.grid(_SCALE_POINTS * self.harmonics))

    @cached_property
    def _scale(self) -> FloatArray:
        """(m, 1 + 2H) coefficients that each use all of the tightest limit; of the offset, half the range."""
        largest = np.abs(self._own_basis).max(axis=2)
        with np.errstate(divide="ignore"):  # an offset has no velocity
            allowed = np.stack([self.joints.half, self.joints.velocity, self.joints.acceleration])
            return np.asarray((allowed[:, :, None] / largest[:, None, :]).min(axis=0))

    def _coefficients(self, variables: FloatArray) -> FloatArray:
        coefficients = self._scale * variables.reshape(self.joints.count, -1)
        coefficients[:, 0] += self.joints.middle
        return coefficients

    def _split(self, variables: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Offsets (n,), sines (n, H) and cosines (n, H) of all joints."""
        coefficients = self._coefficients(variables)
        offset = self.joints.whole(coefficients[:, 0], self.joints.rest)
        sine = self.joints.whole(coefficients[:, 1 : 1 + self.harmonics], 0.0)
        return offset, sine, self.joints.whole(coefficients[:, 1 + self.harmonics :], 0.0)

    def _encoded(self, earlier: FourierSeries | FourierQuintic) -> FloatArray:
        if not abs(earlier.period - self.period) <= _TOLERANCE * self.period:
            raise UsageError(
                f"the earlier motion has a period of {earlier.period:g} s, not {self.period:g} s",
                hint=f"--period {earlier.period:g}",
            )
        count = earlier.sine.shape[1]
        if count > self.harmonics:
            raise UsageError(
                f"the earlier motion has {count} harmonics, more than {self.harmonics}", hint=f"--harmonics {count}"
            )
        travel = (np.abs(earlier.sine) + np.abs(earlier.cosine)).sum(axis=1) * self.period
        self.joints.check_same(len(earlier.offset), earlier.offset, travel)
        rows = self.joints.rows
        missing = np.zeros((len(rows), self.harmonics - count))
        terms = [earlier.offset[rows, None] - self.joints.middle[:, None]]
        terms += [earlier.sine[rows], missing, earlier.cosine[rows], missing]
        return np.asarray((np.concatenate(terms, axis=1) / self._scale).ravel())


@dataclass(frozen=True, eq=False)
class FourierFamily(_Series):
    """Fourier series of one period (ROCR6 eq. 21, AUBO eq. 20), repeated, from rest to rest by a ramp of the pace.

    Attributes:
        period: [s].
        harmonics: order H of the series.
        periods: how many are played at full speed.
        ramp: from rest to full speed [s]; it changes the pace only, so that the path is that of the series.

    Raises:
        UsageError: no joint moves, or a number is not positive.
    """

    ramp: float

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ramp(self.ramp)

    SERIES = FourierSeries

    def motion(self, variables: FloatArray) -> Motion:
        """The motion as played, from rest to rest."""
        return RestToRest(FourierSeries(self.period, *self._split(variables)), self.periods, self.ramp)

    def encode(self, motion: Motion) -> FloatArray:
        """The x of an earlier Fourier series; harmonics that it lacks are 0, its repetitions and ramp do not matter.

        Raises:
            UsageError: another kind of motion, period or set of joints, or more harmonics.
        """
        earlier = unwrapped(motion)
        if not isinstance(earlier, FourierSeries):
            raise UsageError("the earlier motion is no Fourier series", hint="--kind must be that of the file")
        return self._encoded(earlier)

    def begun_near_middle(self, variables: FloatArray) -> FloatArray:
        """The x of the series from another moment on; nearest by the time that the slowest joint needs."""
        time = self.grid(_SCALE_POINTS * self.harmonics)
        way = np.abs(self.path(variables, time).position[self.joints.rows] - self.joints.middle[:, None])
        start = float(time[np.argmin(np.max(way / self.joints.velocity[:, None], axis=0))])
        coefficients = self._scale * variables.reshape(self.joints.count, -1)
        sine, cosine = coefficients[:, 1 : 1 + self.harmonics], coefficients[:, 1 + self.harmonics :]
        angle = 2.0 * np.pi * start / self.period * np.arange(1, self.harmonics + 1)
        turned = (sine * np.cos(angle) + cosine * np.sin(angle), cosine * np.cos(angle) - sine * np.sin(angle))
        return np.asarray((np.concatenate([coefficients[:, :1], *turned], axis=1) / self._scale).ravel())

    def with_longer_ramp(self, factor: float) -> FourierFamily:
        """The same motions with a ramp that is `factor` times longer."""
        return replace(self, ramp=factor * self.ramp)


@dataclass(frozen=True, eq=False)
class FourierQuinticFamily(_Series):
    """Quintic-corrected Fourier series: zero velocity and acceleration at the ends of every period (`FourierQuintic`).

    Attributes:
        period: [s].
        harmonics: order H of the series.
        periods: how many follow each other.

    Raises:
        UsageError: no joint moves, or a number is not positive.
    """

    SERIES = FourierQuintic

    def motion(self, variables: FloatArray) -> Motion:
        """The motion as played, from rest to rest."""
        return FourierQuintic(self.period, *self._split(variables), self.periods)

    def encode(self, motion: Motion) -> FloatArray:
        """The x of an earlier motion of this form; harmonics that it lacks are 0, its repetitions do not matter.

        Raises:
            UsageError: another kind of motion, period or set of joints, or more harmonics.
        """
        if not isinstance(motion, FourierQuintic):
            raise UsageError(
                "the earlier motion is not a quintic-corrected Fourier series", hint="--kind must be that of the file"
            )
        return self._encoded(motion)
