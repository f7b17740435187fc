"""The external torque of each sample period, before any filter: what the model needs less what the drives gave.

An arm moves by M·q̈ + C·q̇ + g + f = τ + τ_ext. The mean of τ_ext over the period around a sample follows from positions
and torques alone, in two ways that differ by O(h²):

    direct     τ_ext = M·q̈ + C·q̇ + g + f − τ, with q̈ the second difference of the positions;
    momentum   τ_ext = Δp/h − Cᵀ·q̇ + g + f − τ, with p = M·q̇ half a period before and after (De Luca et al., "Collision
               detection and safe reaction with the DLR-III lightweight manipulator arm", IROS 2006).

Positive acts on the arm as a positive drive torque does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from drivers.core.arrays import BoolArray, FloatArray
from drivers.core.errors import DataError
from drivers.core.units import ZERO_CELSIUS
from ident.identify.revalidate import stored_choices
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.model.joint_columns import combined
from ident.model.presliding import dahl_steps, presliding_motions
from ident.result.models.gravity_model import refuse_gravity_alone
from ident.result.models.model import Model

LONGEST_STEP = 2.5
"""Periods between two samples from which on there is a gap, and the observer starts again."""
SHORTEST_STEP = 0.2
"""Periods below which a sample repeats the one before, and is left out."""
NUDGE = 1e-4
"""[s] Half the time over which the inertia matrix is differentiated along the motion; errors grow with its square."""


@dataclass(frozen=True)
class JointSamples:
    """Samples of n joints."""

    time: FloatArray  # (N,) the source's clock [s]
    position: FloatArray  # (N, n) [rad or m]
    torque: FloatArray  # (N, n) of the drives, at the joints [N·m or N]
    celsius: FloatArray | None = None  # (N, n) [°C]; None where no temperature is measured


@dataclass(frozen=True)
class Intervals:
    """Sample periods, each around the sample that it is named after."""

    time: FloatArray  # (N,) of that sample [s]
    # position, velocity, acceleration: (N, n) [rad, rad/s, rad/s² or m…]; differences of recorded positions
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    measured: FloatArray  # (N, n) torque of the drives, shifted by the model's delay [N·m or N]
    external: FloatArray  # (N, n) mean external torque, unfiltered [N·m or N]
    celsius: FloatArray | None  # (N, n) [°C]; None where no temperature is measured
    restarted: BoolArray  # (N,) whether a gap lies before it

    def __len__(self) -> int:
        return len(self.time)


def joined(parts: list[Intervals]) -> Intervals:
    """Consecutive intervals as one; `parts` is not empty."""
    if len(parts) == 1:
        return parts[0]
    names = ("time", "position", "velocity", "acceleration", "measured", "external", "restarted")
    rows = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    celsius = [part.celsius for part in parts if part.celsius is not None]
    return Intervals(**rows, celsius=np.concatenate(celsius) if len(celsius) == len(parts) else None)


def rows_of(intervals: Intervals, rows: slice) -> Intervals:
    """Some consecutive intervals."""
    names = ("time", "position", "velocity", "acceleration", "measured", "external", "restarted")
    celsius = None if intervals.celsius is None else intervals.celsius[rows]
    return Intervals(**{name: getattr(intervals, name)[rows] for name in names}, celsius=celsius)


class IntervalTorque:
    """Turns samples into intervals, as many as come, in any division into batches: the result is the same.

    Args:
        model: of the whole arm.
        period: between two samples, nominally [s].
        momentum: by the generalised momentum, else directly.

    Attributes:
        lag: time [s] after a sample at which its interval is known.

    Raises:
        ModelError: a base parameter has no value, or the model knows gravity alone.
    """

    def __init__(self, model: Model, period: float, *, momentum: bool = True) -> None:
        refuse_gravity_alone(model, "the torque of a motion")
        model.require_complete("the external torque")
        self._model, self._period, self._momentum = model, period, momentum
        self._dynamics = model.dynamics
        weightless = replace(self._dynamics.model, gravity=np.zeros(3))
        self._weightless = InverseDynamics(weightless, self._dynamics.base, self._dynamics.parameters)
        choices = stored_choices(model.result)
        self._delays = np.array(choices.joint_delays or (choices.delay,) * model.dof)
        self._delayed = [(delay, np.flatnonzero(self._delays == delay)) for delay in set(self._delays.tolist()) - {0.0}]
        self.lag = max(period, float(self._delays.max()))
        travels = presliding_motions(self._dynamics.model)
        self._motions, self._travels = tuple(travels), np.array(list(travels.values()), dtype=np.float64)
        self._heated = self._dynamics.model.needs_temperature
        self._rows: JointSamples | None = None
        self._next, self._fresh = 1, True
        self._dry = np.zeros(len(travels))

    def add(self, samples: JointSamples) -> Intervals:
        """The intervals (M,) that these samples (N, n) complete; samples that are not finite count as missing.

        Raises:
            DataError: another number of joints, or the model needs a temperature that is not given.
        """
        names = self._model.joint_names
        if samples.position.shape != (len(samples.time), len(names)) or samples.torque.shape != samples.position.shape:
            raise DataError(
                f"samples of shape {samples.position.shape} for {len(names)} joints", where=self._model.name
            )
        if self._heated:
            kelvin = None if samples.celsius is None else samples.celsius + ZERO_CELSIUS
            self._model.require_temperature(kelvin, self._model.name)
        fine = np.isfinite(samples.time) & np.all(np.isfinite(samples.position) & np.isfinite(samples.torque), axis=1)
        samples = samples if fine.all() else _rows(samples, np.flatnonzero(fine))
        parts: list[Intervals] = []
        while len(samples.time):
            samples = self._without_repeated(samples)
            count = self._unbroken(samples.time)
            self._rows = _appended(self._rows, _rows(samples, slice(0, count)))
            samples = _rows(samples, slice(count, None))
            if (part := self._completed()) is not None:
                parts.append(part)
            if len(samples.time):
                self._restart()
        return joined(parts) if parts else self._nothing()

    def _restart(self) -> None:
        self._rows, self._next, self._fresh = None, 1, True
        self._dry = np.zeros(len(self._travels))

    def _nothing(self) -> Intervals:
        none = np.zeros((0, self._model.dof))
        return Intervals(np.zeros(0), none, none, none, none, none, None, np.zeros(0, dtype=bool))

    def _steps(self, time: FloatArray) -> FloatArray:
        """(N,) [s] from the sample before to each of these; a period to the first sample of all."""
        steps = np.empty_like(time)
        if len(time):
            steps[0] = self._period if self._rows is None else time[0] - self._rows.time[-1]
            np.subtract(time[1:], time[:-1], out=steps[1:])
        return steps

    def _without_repeated(self, samples: JointSamples) -> JointSamples:
        steps = self._steps(samples.time)
        # A clock that was set back is a gap, not a repetition.
        kept = (steps >= SHORTEST_STEP * self._period) | (steps < -LONGEST_STEP * self._period)
        return samples if kept.all() else _rows(samples, np.flatnonzero(kept))

    def _unbroken(self, time: FloatArray) -> int:
        """Return how many samples follow the ones before without a gap; at least one where there are none before."""
        steps = self._steps(time)
        broken = ((steps > LONGEST_STEP * self._period) | (steps < 0.0)).nonzero()[0]
        return int(broken[0]) if len(broken) else len(time)

    def _completed(self) -> Intervals | None:
        rows = self._rows
        if rows is None:
            return None
        time, delays = rows.time, self._delays
        start = max(self._next, int(np.searchsorted(time, time[0] - min(0.0, delays.min()))))
        stop = min(len(time) - 1, int(np.searchsorted(time, time[-1] - max(0.0, delays.max()), side="right")))
        if stop <= start:
            return None
        intervals = self._intervals(rows, start, stop)
        first = max(0, min(stop - 1, int(np.searchsorted(time, time[stop] + min(0.0, delays.min()))) - 1))
        self._rows, self._next, self._fresh = _rows(rows, slice(first, None)), stop - first, False
        return intervals

    def _intervals(self, rows: JointSamples, start: int, stop: int) -> Intervals:
        """The intervals of the samples from `start` to before `stop`."""
        at = slice(start, stop)
        time, position = rows.time, rows.position
        steps = (time[start : stop + 1] - time[start - 1 : stop])[:, None]
        rates = (position[start : stop + 1] - position[start - 1 : stop]) / steps
        width = 0.5 * (steps[1:] + steps[:-1])
        velocity = (position[start + 1 : stop + 1] - position[start - 1 : stop - 1]) / (2.0 * width)
        acceleration = (rates[1:] - rates[:-1]) / width
        measured = rows.torque[at].copy()
        for delay, joints in self._delayed:
            measured[:, joints] = _interpolated(time[at] + delay, time, rows.torque[:, joints])
        celsius = None if rows.celsius is None else rows.celsius[at]
        q, dq = np.ascontiguousarray(position[at].T), np.ascontiguousarray(velocity.T)
        needed = self._friction(q, dq, celsius, width[:, 0])
        if self._momentum:
            halves = 0.5 * (position[start - 1 : stop] + position[start : stop + 1])
            momentum = self._momentum_of(halves.T, rates.T)
            needed += np.diff(momentum, axis=1) / width.T + self._without_acceleration(q, dq)
        else:
            ddq = np.ascontiguousarray(acceleration.T)
            needed += self._dynamics.links(q, dq, ddq) + self._dynamics.rotor_inertia @ ddq
        restarted = np.zeros(stop - start, dtype=bool)
        restarted[0] = self._fresh
        external = needed.T - measured
        return Intervals(time[at], position[at], velocity, acceleration, measured, external, celsius, restarted)

    def _momentum_of(self, position: FloatArray, rate: FloatArray) -> FloatArray:
        """P = M(q)·q̇ (n, N) [N·m·s or N·s]."""
        still = np.zeros_like(position)
        return self._weightless.links(position, still, rate) + self._dynamics.rotor_inertia @ rate

    def _without_acceleration(self, position: FloatArray, rate: FloatArray) -> FloatArray:
        """G − Cᵀ·q̇ (n, N) = g + C·q̇ − Ṁ·q̇ [N·m or N]."""
        still = np.zeros_like(position)
        after, before = (self._weightless.links(position + sign * NUDGE * rate, still, rate) for sign in (1.0, -1.0))
        return self._dynamics.links(position, rate, still) - (after - before) / (2.0 * NUDGE)

    def _friction(
        self, position: FloatArray, rate: FloatArray, celsius: FloatArray | None, width: FloatArray
    ) -> FloatArray:
        """Friction, offsets and regrouped weight (n, N) [N·m or N]; dry friction with its presliding state."""
        states = {}
        if self._motions:
            moved = width * np.array([combined(motion, rate) for motion in self._motions])
            rows = dahl_steps(moved, self._travels, self._dry)
            states, self._dry = dict(zip(self._motions, rows, strict=True)), rows[:, -1]
        kelvin = None if celsius is None else celsius.T + ZERO_CELSIUS
        return self._dynamics.friction(rate, position, kelvin, states) + self._dynamics.weight[:, None]


def _interpolated(when: FloatArray, time: FloatArray, values: FloatArray) -> FloatArray:
    """Values (N, n), known at times (M,), at other times (N,) between these [s]."""
    before = np.clip(np.searchsorted(time, when, side="right") - 1, 0, len(time) - 2)
    share = ((when - time[before]) / (time[before + 1] - time[before]))[:, None]
    return np.asarray(values[before] + share * (values[before + 1] - values[before]))


def _rows(samples: JointSamples, rows: slice | np.ndarray[tuple[int], np.dtype[np.intp]]) -> JointSamples:
    celsius = None if samples.celsius is None else samples.celsius[rows]
    return JointSamples(samples.time[rows], samples.position[rows], samples.torque[rows], celsius)


def _appended(before: JointSamples | None, after: JointSamples) -> JointSamples:
    if before is None:
        return after
    celsius = None
    if before.celsius is not None and after.celsius is not None:
        celsius = np.concatenate([before.celsius, after.celsius])
    return JointSamples(
        np.concatenate([before.time, after.time]),
        np.concatenate([before.position, after.position]),
        np.concatenate([before.torque, after.torque]),
        celsius,
    )
