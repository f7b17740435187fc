"""Sums of sines with free frequencies as a family of motions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from daq.motion.trajectories import Motion, RestToRest, SumOfSines
from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from ident.excite.families.moving_joints import (
    Family,
    check_count,
    check_positive,
    check_ramp,
    from_share,
    midrange,
    to_share,
    unwrapped,
)
from ident.excite.path import JointPath

_POINTS_A_WAVE = 40
_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class SinesFamily(Family):
    """Sums of sines (UP6 eq. 8, with an offset), whose frequencies are free within a band.

    x holds the offsets, then the amplitudes, then the frequencies, each (joints that move, sines). An offset counts
    from the middle of the joint's range in halves of it, an amplitude in the one that by itself would use all of the
    tightest limit in the middle of the band; a frequency lies at sin(x) of half the band's width from its middle.

    Played from rest to rest, the motion's own time runs from −ramp/2 to duration + ramp/2, and so does the grid.

    Raises:
        UsageError: no joint moves, a number is not positive, or the band is none.
    """

    duration: float  # at full speed [s]
    sines: int  # of each joint
    ramp: float  # from rest to full speed [s]
    # lowest and highest angular frequency [rad/s]; half a wave to `sines` waves in `duration` where None
    band: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        check_positive("duration", self.duration)
        check_ramp(self.ramp)
        check_count("sines", self.sines, 1)
        low, high = self._band
        if not 0.0 < low < high < np.inf:
            raise UsageError(f"{low:g} to {high:g} rad/s is not a frequency band")

    @property
    def size(self) -> int:
        """Number of decision variables: 1 + 2K for each joint that moves."""
        return self.joints.count * (1 + 2 * self.sines)

    def grid(self, count: int) -> FloatArray:
        """Times (N,) [s], `count` of them within `duration`, and as dense before and after, where the ramps are."""
        total = int(np.ceil(max(count, 2) * (1.0 + self.ramp / self.duration)))
        return np.linspace(-0.5 * self.ramp, self.duration + 0.5 * self.ramp, total)

    def path(self, variables: FloatArray, time: FloatArray) -> JointPath:
        """The sums at full speed; before 0 and after `duration` they go on."""
        return self.joints.path(time, *SumOfSines(self.duration, *self._values(variables)).evaluate(time))

    def pull_back(self, variables: FloatArray, time: FloatArray, gradient: FloatArray) -> FloatArray:
        """Implement `Family`."""
        _, amplitude, frequency = self._values(variables)
        w = frequency[:, :, None]
        sin, cos = np.sin(w * time), np.cos(w * time)
        turned = w * time
        by_amplitude = np.stack([sin, w * cos, -(w**2) * sin])
        by_frequency = np.stack([time * cos, cos - turned * sin, -w * (2.0 * sin + turned * cos)])
        of_moving = gradient[..., self.joints.rows, :]
        shape = (*gradient.shape[:-3], -1)
        slope = amplitude * 0.5 * (self._band[1] - self._band[0]) * np.cos(self._split(variables)[2])
        terms = [
            of_moving[..., 0, :, :].sum(axis=-1) * self.joints.half,
            (np.einsum("...cmt,cmkt->...mk", of_moving, by_amplitude) * self._scale).reshape(shape),
            (np.einsum("...cmt,cmkt->...mk", of_moving, by_frequency) * slope).reshape(shape),
        ]
        return np.concatenate(terms, axis=-1)

    def random(self, generator: np.random.Generator) -> FloatArray:
        """A random x within the limits (`MovingJoints.fitted`); the frequencies spread over the band."""
        shape = (self.joints.count, self.sines)
        amplitude = self._scale * generator.normal(size=shape)
        share = 2.0 * (np.arange(self.sines) + generator.uniform(size=shape)) / self.sines - 1.0
        low, high = self._band
        frequency = 0.5 * (low + high) + 0.5 * (high - low) * share
        wave = SumOfSines(self.duration, np.zeros(self.joints.count), amplitude, frequency)
        waves = high * self.duration / (2.0 * np.pi)
        factor, offset = self.joints.fitted(*wave.evaluate(self.grid(int(_POINTS_A_WAVE * waves) + 2)), generator)
        return self._joined(offset, factor[:, None] * amplitude, share)

    def middle(self, variables: FloatArray) -> FloatArray:
        """Middle (m,) of the range of each moving joint's motion [rad or m]."""
        waves = self._band[1] * self.duration / (2.0 * np.pi)
        time = self.grid(int(_POINTS_A_WAVE * waves) + 2)
        return midrange(SumOfSines(self.duration, *self._values(variables)).evaluate(time)[0])

    def about(self, variables: FloatArray, pose: FloatArray, share: float) -> FloatArray:
        """Implement `Family`; the frequencies are unchanged."""
        offset, amplitude, frequency = self._split(variables)
        middle = self.middle(variables)
        away = share * (self.joints.middle + self.joints.half * offset - middle)
        moved = (pose + away - self.joints.middle) / self.joints.half
        return np.concatenate([moved, (share * amplitude).ravel(), frequency.ravel()])

    def motion(self, variables: FloatArray) -> Motion:
        """The motion as played, from rest to rest."""
        return RestToRest(SumOfSines(self.duration, *self._whole(variables)), 1, self.ramp)

    def encode(self, motion: Motion) -> FloatArray:
        """The x of an earlier sum of sines; sines that it lacks get amplitude 0, its ramp does not matter.

        A frequency at an end of the band is moved inwards a little, as `from_share` says.

        Raises:
            UsageError: another kind of motion, duration or set of joints, more sines, or a frequency out of the band.
        """
        earlier = unwrapped(motion)
        if not isinstance(earlier, SumOfSines):
            raise UsageError("the earlier motion is not a sum of sines", hint="--kind must be that of the file")
        if not abs(earlier.duration - self.duration) <= _TOLERANCE * self.duration:
            raise UsageError(
                f"the earlier motion lasts {earlier.duration:g} s at full speed, not {self.duration:g} s",
                hint=f"--period {earlier.duration:g}",
            )
        count = earlier.amplitude.shape[1]
        if count > self.sines:
            raise UsageError(
                f"the earlier motion has {count} sines, more than {self.sines}", hint=f"--harmonics {count}"
            )
        self.joints.check_same(len(earlier.offset), earlier.offset, np.abs(earlier.amplitude).sum(axis=1))
        rows = self.joints.rows
        low, high = self._band
        # A negative frequency is the positive one with the opposite amplitude; one of 0, or of amplitude 0, is nothing.
        sign = np.sign(earlier.frequency[rows])
        amplitude = sign * earlier.amplitude[rows]
        frequency = np.where(amplitude == 0.0, 0.5 * (low + high), np.abs(earlier.frequency[rows]))
        share = (frequency - 0.5 * (low + high)) / (0.5 * (high - low))
        if np.any(np.abs(share) > 1.0 + _TOLERANCE):
            worst = frequency.flat[int(np.argmax(np.abs(share)))]
            raise UsageError(
                f"the earlier motion has a frequency of {worst:.5g} rad/s; the band is {low:.5g} to {high:.5g} rad/s",
                hint="more --harmonics widen the band",
            )
        missing = np.zeros((len(rows), self.sines - count))
        padded = [np.concatenate([values, missing], axis=1) for values in (amplitude, share)]
        return self._joined(earlier.offset[rows], *padded)

    def with_longer_ramp(self, factor: float) -> SinesFamily:
        """The same motions with a ramp that is `factor` times longer."""
        return replace(self, ramp=factor * self.ramp)

    @cached_property
    def _band(self) -> tuple[float, float]:
        fundamental = 2.0 * np.pi / self.duration
        return self.band if self.band is not None else (0.5 * fundamental, self.sines * fundamental)

    @cached_property
    def _scale(self) -> FloatArray:
        """(m, 1) amplitudes that by themselves would use all of the tightest limit in the middle of the band."""
        middle = np.sqrt(self._band[0] * self._band[1])
        allowed = [self.joints.half, self.joints.velocity / middle, self.joints.acceleration / middle**2]
        return np.asarray(np.min(allowed, axis=0)[:, None])

    def _split(self, variables: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        count = self.joints.count
        rows = variables[count:].reshape(2, count, self.sines)
        return variables[:count], rows[0], rows[1]

    def _values(self, variables: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Offsets (m,), amplitudes (m, K) and frequencies (m, K) of the joints that move."""
        offset, amplitude, frequency = self._split(variables)
        low, high = self._band
        share = to_share(frequency)
        return (
            self.joints.middle + self.joints.half * offset,
            self._scale * amplitude,
            0.5 * (low + high) + 0.5 * (high - low) * share,
        )

    def _joined(self, offset: FloatArray, amplitude: FloatArray, share: FloatArray) -> FloatArray:
        """The x of offsets (m,), amplitudes (m, K) and places (m, K) of the frequencies in the band."""
        scaled = (offset - self.joints.middle) / self.joints.half
        return np.concatenate([scaled, (amplitude / self._scale).ravel(), from_share(share).ravel()])

    def _whole(self, variables: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        offset, amplitude, frequency = self._values(variables)
        # A joint at rest has sines of amplitude 0; their frequency is one of the band.
        return (
            self.joints.whole(offset, self.joints.rest),
            self.joints.whole(amplitude, 0.0),
            self.joints.whole(frequency, self._band[0]),
        )
