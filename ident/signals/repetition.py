"""Repetitions of a motion, within a recording or from one to the next.

Excitation trajectories are periodic and are recorded for several periods. Noise averages out over them, but an error
that depends on the motion (ripple, a missing friction term) repeats, too: repetitions are not new evidence
against it. Error bars must therefore treat samples of the same phase as one, which needs to be found in the data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray, IntArray, true_runs

SAME_MOTION = 0.01
"""Mean square difference of two velocities, relative to the sum of their mean squares, below which they are the same
motion: 10 % in amplitude. Independent motions give 1."""

DIFFERENT_MOTION = 0.5
"""The search for a period starts where the velocity has first become this different from itself."""

SIMILAR = 0.4
"""The same difference, below which a lag is looked at without the ends of what it has twice: a motion goes into and out
of its periods by ramps."""

WINDOWS = 40
"""Parts of it; those at the ends that differ are ramps, as long as they are no more than half of it."""

LEAST_OVERLAP = 0.1
"""Share of the shorter segment that must be there twice."""


@dataclass(frozen=True)
class _Known:
    """A segment with its phases: velocity (n, M), phases (M,), its period in samples or None."""

    velocity: FloatArray
    phases: IntArray
    period: int | None


def motion_phases(velocities: Sequence[FloatArray]) -> tuple[IntArray, ...]:
    """Phases (M,) of segments with velocities (n, M), integers: samples at the same place of the same motion share one.

    They are consecutive along a motion, and disjoint for different motions.
    """
    earlier_segments: list[_Known] = []
    following = 0
    for velocity in velocities:
        count = velocity.shape[1]
        period = own_period(velocity)
        phases = following + (np.arange(count) if period is None else np.arange(count) % period)
        for earlier in earlier_segments:
            lag = _best_lag(earlier.velocity, velocity)
            if lag is not None:
                phases = _phases_like(earlier, lag, phases)
                break
        following = max(following, int(phases.max(initial=-1)) + 1)
        earlier_segments.append(_Known(velocity, phases, period))
    return tuple(entry.phases for entry in earlier_segments)


def own_period(velocity: FloatArray) -> int | None:
    """Samples after which a motion (n, M) repeats itself; None where it does not."""
    count = velocity.shape[1]
    longest = int(count * (1.0 - LEAST_OVERLAP))
    if longest < 2:
        return None
    difference = _differences(velocity, velocity)[count - 1 : count - 1 + longest]
    apart = np.flatnonzero(difference > DIFFERENT_MOTION)
    if len(apart) == 0:
        return None
    difference[: apart[0]] = 1.0
    return next((lag for lag in _minima(difference) if _repeats(velocity[:, lag:], velocity[:, :-lag])), None)


def _minima(difference: FloatArray) -> list[int]:
    """Return where each interval of similar motion has its smallest difference."""
    return [start + int(np.argmin(difference[start:stop])) for start, stop in true_runs(difference < SIMILAR)]


def _repeats(first: FloatArray, second: FloatArray) -> bool:
    """Return whether two velocities (n, M) are the same motion, but for ramps at the ends."""
    scale = np.sqrt(np.mean(first**2 + second**2, axis=1, keepdims=True))
    scale, window = np.where(scale > 0, scale, 1.0), -(-first.shape[1] // WINDOWS)
    starts = np.arange(0, first.shape[1], window)
    different, energy = (
        np.add.reduceat(np.sum(values, axis=0), starts)
        for values in (((first - second) / scale) ** 2, (first / scale) ** 2 + (second / scale) ** 2)
    )
    same = np.flatnonzero(different <= SAME_MOTION * energy)
    if len(same) == 0:
        return False
    inner = slice(same[0], same[-1] + 1)
    long_enough = 2 * (same[-1] + 1 - same[0]) >= len(starts)
    return bool(long_enough and np.sum(different[inner]) < SAME_MOTION * np.sum(energy[inner]))


def _best_lag(earlier: FloatArray, later: FloatArray) -> int | None:
    """Lag at which sample t of `later` repeats sample t + lag of `earlier`; None where there is none."""
    if earlier.shape[1] == 0 or later.shape[1] == 0:
        return None
    difference = _differences(later, earlier)
    least = int(np.ceil(LEAST_OVERLAP * min(earlier.shape[1], later.shape[1])))
    if least:
        difference[:least] = difference[-least:] = 1.0
    for place in sorted(_minima(difference), key=lambda place: float(difference[place])):
        lag: int = place - later.shape[1] + 1
        own = slice(max(0, -lag), min(later.shape[1], earlier.shape[1] - lag))
        if _repeats(earlier[:, own.start + lag : own.stop + lag], later[:, own]):
            return lag
    return None


def _phases_like(earlier: _Known, lag: int, own: IntArray) -> IntArray:
    """Phases of a segment that repeats `earlier`, which lies `lag` samples further on; its own ones elsewhere."""
    place = np.arange(len(own)) + lag
    count = len(earlier.phases)
    if earlier.period is not None:
        return np.asarray(earlier.phases[place % earlier.period])
    inside = (place >= 0) & (place < count)
    return np.where(inside, earlier.phases[np.clip(place, 0, count - 1)], own)


def _differences(first: FloatArray, second: FloatArray) -> FloatArray:
    """Relative mean square difference of `second` (n, K) moved against `first` (n, M); entry i is lag i − (M − 1)."""
    scale = np.sqrt(np.mean(np.concatenate([first, second], axis=1) ** 2, axis=1, keepdims=True))
    scale = np.where(scale > 0, scale, 1.0)  # every joint counts alike
    first, second = first / scale, second / scale
    product = correlation(first, second).sum(axis=0)
    ones_first, ones_second = np.ones(first.shape[1]), np.ones(second.shape[1])
    energy = _overlap(np.sum(first**2, axis=0), ones_second) + _overlap(ones_first, np.sum(second**2, axis=0))
    tiny = 1e-9 * float(energy.max(initial=0.0)) + np.finfo(float).tiny
    return np.asarray(np.where(energy > tiny, 1.0 - 2.0 * product / np.maximum(energy, tiny), 1.0))


def _overlap(first: FloatArray, second: FloatArray) -> FloatArray:
    """Correlation of two non-negative series at every lag, as in `_differences`."""
    return np.maximum(correlation(first, second), 0.0)


def correlation(first: FloatArray, second: FloatArray) -> FloatArray:
    """Sums (…, M + K − 1) of the products of `first` (…, M) with `second` (…, K) moved; entry i is lag i − (M − 1)."""
    size = first.shape[-1] + second.shape[-1] - 1
    length = 1 << (size - 1).bit_length()  # scipy.fft has closer ones and is slow to import
    backwards = np.ascontiguousarray(first[..., ::-1])
    spectrum = np.fft.rfft(second, length) * np.fft.rfft(backwards, length)
    return np.asarray(np.fft.irfft(spectrum, length)[..., :size])
