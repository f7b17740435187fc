"""Slow passes of single joints up and down: half the sum is gravity, half the difference friction.

A pass is a period in which one joint moves slowly in one direction and the others rest. Passes of one joint belong to
the same sweep where the others rest in the same pose. Over bins of the position that both ways share, the mean signals
up and down give

    half sum = gravity/gain,   half difference = friction/gain

whatever the friction depends on, as long as it is the same in both directions: speed, position, temperature, load.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import FloatArray
from ident.signals.prepared import Segment

POSE_TOLERANCE = 0.01
"""Joints at rest within this [rad or m] of each other make the same pose."""

LARGEST_ACCELERATION = 0.1
"""Samples above it [rad/s² or m/s²] are left out: at a metre from the axis, 1 % of gravity."""

SAME_SPEED = 0.1
"""Up and down may differ in speed by this share: friction depends on it."""

BINS = 40
"""Bins a sweep: short against the positions over which gravity changes."""

FEWEST_SAMPLES = 3
"""Least number of samples per direction and bin."""


@dataclass(frozen=True)
class JointPass:
    """One joint moving in one direction; M samples that count."""

    joint: int  # its index
    upward: bool  # whether its position grows
    pose: FloatArray  # (n,) positions of all joints; that of the moving one means nothing [rad or m]
    # position, speed, signal: (M,) of the moving joint [rad or m, rad/s or m/s, A or V]
    position: FloatArray
    speed: FloatArray
    signal: FloatArray


@dataclass(frozen=True)
class Sweep:
    """A joint up and down, once without and once with the load, over B bins."""

    joint: int  # its index
    pose: FloatArray  # (n, B) positions of all joints in the loaded run [rad or m]
    half_sum: FloatArray  # (2, B) of free and loaded run [A or V]
    half_difference: FloatArray  # (2, B) up minus down [A or V]
    speed: float  # mean [rad/s or m/s]


def passes_of(segments: Sequence[Segment], rest_velocity: float) -> list[JointPass]:
    """All slow passes; `torque` of the segments is the motors' signal."""
    return [slow_pass for segment in segments for slow_pass in _passes(segment, rest_velocity)]


def _passes(segment: Segment, rest_velocity: float) -> Iterator[JointPass]:
    moving = np.abs(segment.velocity) >= rest_velocity
    alone = segment.used & (moving.sum(axis=0) == 1)
    joint = np.where(alone, np.argmax(moving, axis=0), -1)
    sample = np.arange(len(joint))
    upward = segment.velocity[joint, sample] > 0
    state = np.where(alone, 2 * joint + upward, -1)
    edges = np.flatnonzero(np.diff(np.concatenate([[-2], state, [-2]])))
    for start, stop in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        if state[start] < 0:
            continue
        mover, whole = int(joint[start]), slice(start, stop)
        slow = np.abs(segment.acceleration[mover, whole]) <= LARGEST_ACCELERATION
        if slow.any():
            yield JointPass(
                joint=mover,
                upward=bool(upward[start]),
                pose=np.median(segment.position[:, whole], axis=1),
                position=segment.position[mover, whole][slow],
                speed=np.abs(segment.velocity[mover, whole])[slow],
                signal=segment.torque[mover, whole][slow],
            )


def sweeps_of(free: Sequence[JointPass], loaded: Sequence[JointPass]) -> list[Sweep]:
    """Sweeps for which both runs have passes in both directions, at the same speed, over shared positions."""
    poses: list[tuple[int, FloatArray]] = []
    for slow_pass in (*free, *loaded):
        if not any(_same_pose(slow_pass, joint, pose) for joint, pose in poses):
            poses.append((slow_pass.joint, slow_pass.pose))
    sweeps = []
    for joint, pose in poses:
        groups = [
            [slow_pass for slow_pass in run if slow_pass.upward == upward and _same_pose(slow_pass, joint, pose)]
            for run in (free, loaded)
            for upward in (True, False)
        ]
        if all(groups) and (sweep := _sweep(joint, pose, groups)) is not None:
            sweeps.append(sweep)
    return sweeps


def _same_pose(slow_pass: JointPass, joint: int, pose: FloatArray) -> bool:
    apart = np.abs(slow_pass.pose - pose)
    apart[joint] = 0.0
    return slow_pass.joint == joint and bool(np.max(apart) <= POSE_TOLERANCE)


def _sweep(joint: int, pose: FloatArray, groups: Sequence[Sequence[JointPass]]) -> Sweep | None:
    """Bins of the groups free up, free down, loaded up, loaded down; None where they share no positions."""
    signals = [
        [np.concatenate([getattr(slow_pass, name) for slow_pass in group]) for name in _SIGNALS] for group in groups
    ]
    low = max(float(position.min()) for position, _, _ in signals)
    high = min(float(position.max()) for position, _, _ in signals)
    if not low < high:
        return None
    edges = np.linspace(low, high, BINS + 1)
    means = np.array(
        [_bin_means(position, speed, signal, edges) for position, speed, signal in signals]
    )  # (4, 3, BINS)
    speed = means[:, 1]
    filled = np.all(np.isfinite(means), axis=(0, 1))
    for up, down in ((0, 1), (2, 3)):
        with np.errstate(invalid="ignore"):
            filled &= np.abs(speed[up] - speed[down]) <= SAME_SPEED * np.maximum(speed[up], speed[down])
    if not filled.any():
        return None
    position, speed, signal = means[:, :, filled].transpose(1, 0, 2)
    whole = np.repeat(pose[:, None], position.shape[1], axis=1)
    whole[joint] = position[2:].mean(axis=0)
    return Sweep(
        joint=joint,
        pose=whole,
        half_sum=0.5 * (signal[::2] + signal[1::2]),
        half_difference=0.5 * (signal[::2] - signal[1::2]),
        speed=float(speed.mean()),
    )


_SIGNALS = ("position", "speed", "signal")


def _bin_means(position: FloatArray, speed: FloatArray, signal: FloatArray, edges: FloatArray) -> FloatArray:
    """Means (3, B) of position, speed and signal in bins; nan where there are too few samples."""
    place: npt.NDArray[np.int64] = np.clip(np.searchsorted(edges, position, side="right") - 1, -1, len(edges) - 1)
    inside = (place >= 0) & (place < len(edges) - 1)
    count = np.bincount(place[inside], minlength=len(edges) - 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.array(
            [
                np.where(
                    count >= FEWEST_SAMPLES,
                    np.bincount(place[inside], weights=values[inside], minlength=len(edges) - 1) / count,
                    np.nan,
                )
                for values in (position, speed, signal)
            ]
        )
