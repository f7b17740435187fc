"""Pieces of motion for servo arms: slow ramps through reversals, steps, and chirps, on a ladder of amplitudes.

Each begins and ends at rest in its pose. All joints move at once, each with its own signs and phases, within the shares
of their limits that are given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from daq.motion.trajectories import QUINTIC_ACCELERATION, QUINTIC_VELOCITY
from drivers.core.arrays import FloatArray

PERIOD = 0.02
"""[s] between two commands."""

SEGMENT = 4.0
"""[s] of a piece."""

LADDER = (0.15, 0.4, 1.0)
"""Amplitudes, as shares of the largest."""

KINDS = ("ramp", "steps", "chirp")

LARGEST = 0.5
"""[rad or m] of an amplitude, at most."""

SMOOTHED = 0.12
"""[s] over which the reversal of a ramp is rounded."""

STEPS = 4
"""Moves of a piece with steps; the last one leads back."""

CHIRP = (0.3, 4.0)
"""[Hz] at the beginning and end of a chirp."""


@dataclass(frozen=True)
class Room:
    """What a motion may use, (n,) each."""

    # low, high: positions [rad or m]
    low: FloatArray
    high: FloatArray
    velocity: FloatArray  # [rad/s or m/s]
    acceleration: FloatArray  # [rad/s² or m/s²]


@dataclass(frozen=True, eq=False)
class ServoSegment:
    """A piece of motion."""

    kind: str  # one of `KINDS`
    amplitude: float  # share of the largest
    pose: int  # number of the pose that it begins and ends in
    position: FloatArray  # (K, n) every `PERIOD` [rad or m]


def segment(kind: str, share: float, pose: int, centre: FloatArray, room: Room, seed: int) -> ServoSegment:
    """A piece about a pose; a joint that exceeds a limit moves less far."""
    generator = np.random.default_rng([seed, pose, KINDS.index(kind), round(100 * share)])
    reach = share * np.minimum(LARGEST, np.minimum(room.high - centre, centre - room.low))
    shape = {"ramp": _ramp, "steps": _steps, "chirp": _chirp}[kind]
    columns = [
        shape(float(reach[joint]), float(room.velocity[joint]), float(room.acceleration[joint]), generator)
        for joint in range(len(centre))
    ]
    moved = np.stack(columns, axis=1)
    return ServoSegment(kind, share, pose, centre + moved * _fitting(moved, room))


def way(start: FloatArray, end: FloatArray, room: Room) -> FloatArray:
    """Positions (K, n) of a quintic from rest to rest, the first left out; empty where there is no way."""
    distance = np.abs(end - start)
    if not np.any(distance > 1e-9):
        return np.empty((0, len(start)))
    seconds = float(_move_time(distance, room.velocity, room.acceleration).max())
    count = int(np.ceil(seconds / PERIOD))
    return np.asarray(start + _quintic(np.arange(1, count + 1) / count)[:, None] * (end - start))


def _times() -> FloatArray:
    return np.asarray(np.arange(round(SEGMENT / PERIOD) + 1) * PERIOD, dtype=np.float64)


def _ramp(reach: float, velocity: float, acceleration: float, generator: np.random.Generator) -> FloatArray:
    cycles = int(generator.integers(1, 3))
    time = _times()
    inner = SEGMENT - 4 * SMOOTHED
    phase = np.clip((time - 2 * SMOOTHED) / inner, 0.0, 1.0) * cycles
    triangle = np.abs((phase + 0.75) % 1.0 - 0.5) * 4.0 - 1.0
    window = np.hanning(round(2 * SMOOTHED / PERIOD) + 3)[1:-1]
    sign = float(generator.choice([-1.0, 1.0]))
    return np.asarray(sign * reach * np.convolve(triangle, window / window.sum(), mode="same"), dtype=np.float64)


def _steps(reach: float, velocity: float, acceleration: float, generator: np.random.Generator) -> FloatArray:
    goals = [0.0, *(reach * generator.uniform(0.3, 1.0, STEPS - 1) * _alternating(generator)).tolist(), 0.0]
    time, each = _times(), SEGMENT / STEPS
    path = np.empty_like(time)
    for index in range(STEPS):
        start, end = goals[index], goals[index + 1]
        seconds = float(np.min([each, _move_time(np.array([abs(end - start)]), velocity, acceleration)[0] + 1e-9]))
        inside = time >= index * each - 1e-9
        path[inside] = start + _quintic(np.clip((time[inside] - index * each) / seconds, 0.0, 1.0)) * (end - start)
    return path


def _alternating(generator: np.random.Generator) -> FloatArray:
    return np.asarray(generator.choice([-1.0, 1.0]) * (-1.0) ** np.arange(STEPS - 1), dtype=np.float64)


def _chirp(reach: float, velocity: float, acceleration: float, generator: np.random.Generator) -> FloatArray:
    time, (slow, fast) = _times(), CHIRP
    rate = 2 * np.pi * (slow + (fast - slow) * time / SEGMENT)
    angle = 2 * np.pi * (slow * time + 0.5 * (fast - slow) * time**2 / SEGMENT)
    size = np.minimum(reach, np.minimum(velocity / rate, acceleration / rate**2))
    ends = np.clip(np.minimum(time, SEGMENT - time) / 0.4, 0.0, 1.0)
    return np.asarray(_quintic(ends) * size * np.sin(angle + generator.uniform(0.0, np.pi)), dtype=np.float64)


def _quintic(share: FloatArray) -> FloatArray:
    return np.asarray(share**3 * (10.0 - 15.0 * share + 6.0 * share**2), dtype=np.float64)


def _move_time(distance: FloatArray, velocity: FloatArray | float, acceleration: FloatArray | float) -> FloatArray:
    by_speed, by_rate = QUINTIC_VELOCITY * distance / velocity, np.sqrt(QUINTIC_ACCELERATION * distance / acceleration)
    return np.asarray(np.maximum(by_speed, by_rate), dtype=np.float64)


def _fitting(moved: FloatArray, room: Room) -> FloatArray:
    """(n,) factors by which the joints keep their velocities and accelerations."""
    spline = CubicSpline(_times(), moved, axis=0, bc_type="clamped")
    fine = np.linspace(0.0, SEGMENT, 8 * len(moved))
    speed, rate = np.abs(spline(fine, 1)).max(axis=0), np.abs(spline(fine, 2)).max(axis=0)
    by_speed, by_rate = room.velocity / np.maximum(speed, 1e-12), room.acceleration / np.maximum(rate, 1e-12)
    factors: FloatArray = np.minimum(1.0, np.minimum(by_speed, by_rate))
    return factors


def joined(segments: Sequence[ServoSegment], poses: FloatArray, room: Room) -> FloatArray:
    """Positions (K, n) of pieces one after the other, from the first pose and back to it, with rests at both ends."""
    rest = round(0.5 / PERIOD)
    parts = [np.repeat(poses[:1], rest, axis=0)]
    for piece in segments:
        parts += [way(parts[-1][-1], poses[piece.pose], room), piece.position[1:]]
    parts += [way(parts[-1][-1], poses[0], room), np.repeat(poses[:1], rest, axis=0)]
    return np.concatenate(parts)
