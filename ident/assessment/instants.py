"""A recording at a few instants: the light copy of the equations that many hypotheses are tried on.

The torque is filtered as in the fit; the motion lies below the filter's cut-off, so that the regressor at the filtered
torque's instants stands for the filtered regressor, except near velocity reversals, which are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import FloatArray
from ident.model.regressor import RegressorKernel, dense_regressor
from ident.regression.velocity_reversals import reversal_mask
from ident.signals.prepared import Prepared, Segment

MOST_INSTANTS = 2000
NEAR_REVERSAL = 0.1
"""Share of a velocity's root mean square below which a motor's equation is left out."""

MOTION = ("position", "velocity", "acceleration")

BLOCKS = 8
"""Consecutive parts of the data that hypotheses are validated on, one held out after the other."""


@dataclass(frozen=True)
class Columns:
    """Recorded column of each joint, and its factor."""

    order: tuple[int, ...]  # (n,) index of the recorded column
    factor: tuple[float, ...]  # (n,) of it

    def of(self, values: FloatArray) -> FloatArray:
        """The columns (n, …) so taken."""
        return np.asarray(values[list(self.order)] * np.array(self.factor).reshape(-1, *[1] * (values.ndim - 1)))


@dataclass(frozen=True, eq=False)
class Track:
    """A segment and its friction's columns."""

    segment: Segment  # as prepared
    time: FloatArray  # (M,) stamps of the filtered samples [s]
    friction: FloatArray  # (n, c, M) columns that are no link's, filtered like the torque


@dataclass(frozen=True, eq=False)
class Instants:
    """Motion and torque at N instants."""

    # position, velocity, acceleration: (n, N) [rad, rad/s, rad/s² or m…]
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    torque: FloatArray  # (n, N) filtered [N·m or N]
    counted: npt.NDArray[np.bool_]  # (n, N) whether a motor's equation takes part
    block: npt.NDArray[np.int64]  # (N,) which of `BLOCKS` consecutive parts an instant belongs to
    time: FloatArray  # (N,) stamps [s]
    temperature: FloatArray | None = None  # (n, N) [K]; None where none was recorded
    # (n, c, N) columns of no link, filtered like the torque; None where the positions are others
    friction: FloatArray | None = None
    friction_columns: tuple[int, ...] = ()  # (c,) standard columns of `friction`
    tracks: tuple[Track, ...] = ()  # segments that the instants are taken from
    track: npt.NDArray[np.int64] | None = None  # (N,) index of each instant's track

    @property
    def motion(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray | None]:
        """What regressors and torques are computed from."""
        return self.position, self.velocity, self.acceleration, self.temperature

    def with_positions(self, columns: Columns) -> Instants:
        """The same with other columns taken for the positions."""
        return replace(
            self,
            position=columns.of(self.position),
            velocity=columns.of(self.velocity),
            acceleration=columns.of(self.acceleration),
            counted=self.counted[list(columns.order)],
            friction=None,
        )

    def without_constants(self) -> Instants:
        """The same with torques about their means: what offsets explain makes no fit a good one."""
        weight = self.counted / np.maximum(1, np.sum(self.counted, axis=1, keepdims=True))
        return replace(self, torque=self.torque - np.sum(weight * self.torque, axis=1, keepdims=True))

    def less(self, joint: int, other: int, factor: float) -> Instants:
        """The same with another joint's motion, times a factor, taken off a joint's."""
        changed = {}
        for name in MOTION:
            changed[name] = getattr(self, name).copy()
            changed[name][joint] -= factor * changed[name][other]
        return replace(self, **changed, friction=None)

    def shifted(self, joint: int, angle: float) -> Instants:
        """The same with a joint's zero elsewhere [rad or m]."""
        position = self.position.copy()
        position[joint] += angle
        return replace(self, position=position)

    def later(self, joint: int, seconds: float) -> Instants:
        """The same with a joint's motion taken from later samples, as if its column came late."""
        changed = {name: getattr(self, name).copy() for name in MOTION}
        friction = None if self.friction is None else self.friction.copy()
        for number, track in enumerate(self.tracks):
            here = np.flatnonzero(self.track == number)
            for name, values in later_motion(track.segment, joint, seconds, self.time[here]).items():
                changed[name][joint, here] = values
            if friction is not None:
                for column, values in enumerate(track.friction[joint]):
                    friction[joint, column, here] = np.interp(self.time[here] + seconds, track.time, values)
        return replace(self, **changed, friction=friction)

    def regressor(self, kernel: RegressorKernel) -> FloatArray:
        """(n, b, N) of the kernel's columns."""
        return dense_regressor(kernel, *self.motion)

    def filtered_regressor(self, kernel: RegressorKernel) -> FloatArray:
        """The same with the friction's columns, which jump at velocity reversals, as the filter leaves them."""
        regressor = self.regressor(kernel)
        if self.friction is not None:
            for number, column in enumerate(kernel.columns):
                if column in self.friction_columns:
                    regressor[:, number] = self.friction[:, self.friction_columns.index(column)]
        return regressor


def later_motion(segment: Segment, joint: int, seconds: float, time: FloatArray) -> dict[str, FloatArray]:
    """A joint's position, velocity and acceleration (N,) that much later than the stamps (N,) [s]."""
    return {name: np.interp(time + seconds, segment.time, getattr(segment, name)[joint]) for name in MOTION}


def instants(kernel: RegressorKernel, runs: Sequence[Prepared]) -> Instants:
    """Return at most `MOST_INSTANTS` instants, spread evenly over all used samples of the filtered torques."""
    parameters = kernel.model.parameters
    others = RegressorKernel(kernel.model, [c for c in kernel.columns if parameters[c].kind != "inertial"])
    parts: dict[str, list[FloatArray]] = {}
    counted: list[npt.NDArray[np.bool_]] = []
    tracks: list[Track] = []
    for run in runs:
        every = slice(None, None, run.parallel_filter.factor)
        for segment in run.segments:
            left_out = reversal_mask(kernel, segment, NEAR_REVERSAL) if segment.used.any() else ~segment.used[None]
            if segment.resting is not None:
                left_out = left_out | segment.resting
            rows = {
                "time": segment.time[every],
                "track": np.full(len(segment.time[every]), len(tracks)),
                "position": segment.position[:, every],
                "velocity": segment.velocity[:, every],
                "acceleration": segment.acceleration[:, every],
                "torque": run.parallel_filter.apply(segment.torque),
            }
            counted.append(~left_out[:, every][:, segment.used[every]])
            motion = (segment.position, segment.velocity, segment.acceleration, segment.temperature)
            packed = dense_regressor(others, *motion).reshape(-1, len(segment.time))
            rows["friction"] = np.zeros((len(packed), len(rows["torque"][0])))
            acting = np.any(packed != 0.0, axis=1)
            if acting.any():
                rows["friction"][acting] = run.parallel_filter.apply(packed[acting])
            shape = (kernel.model.dof, len(others.columns), rows["friction"].shape[1])
            tracks.append(Track(segment, rows["time"], rows["friction"].reshape(shape)))
            if segment.temperature is not None:
                rows["temperature"] = segment.temperature[:, every]
            for name, values in rows.items():
                parts.setdefault(name, []).append(values[..., segment.used[every]])
    joined = {name: np.concatenate(values, axis=-1) for name, values in parts.items()}
    count = joined["position"].shape[1]
    chosen = np.linspace(0, max(0, count - 1), min(count, MOST_INSTANTS)).astype(int)
    taken = {name: values[..., chosen] for name, values in joined.items()}
    block = np.arange(len(chosen)) * BLOCKS // max(1, len(chosen))
    return Instants(
        **{name: taken[name] for name in ("time", "position", "velocity", "acceleration", "torque")},
        counted=np.concatenate(counted, axis=1)[:, chosen],
        block=block,
        temperature=taken.get("temperature"),
        friction=taken["friction"].reshape(kernel.model.dof, len(others.columns), len(chosen)),
        friction_columns=others.columns,
        tracks=tuple(tracks),
        track=taken["track"].astype(np.int64),
    )
