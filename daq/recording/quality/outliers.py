"""Wrong samples of a recorded signal: spikes of a current, encoder glitches, positions that jump.

A sample, or up to three in a row, is an outlier where it is far from what its neighbours on both sides say. These are
fitted with a cubic in the recorded time, without the one that fits worst, which may be another outlier. Far is many
times the largest of three scales: the signal's white noise, its quantisation, and what the same cubic leaves of the
neighbours, so that a velocity reversal, a step of friction or a burst of noise, which no cubic follows, is none.

Positions jump between two samples whose stamps go on: a lost zero, a turn that wraps, rows that are missing. A joint
cannot move between two samples by many times what it moves between those around. Where several joints jump at once,
rows are missing there or stand twice; where one does, its encoder lost counts, or its angle was wrapped.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from daq.recording.quality.quantisation import quantisation_step, resolution
from drivers.core.arrays import BoolArray, FloatArray, IntArray
from drivers.core.ranges import STAMP

LONGEST_OUTLIER = 3
"""Consecutive wrong samples; more of them are a signal."""

NEIGHBOURS = 5
"""Samples on each side that the cubic is fitted to."""

OUTLIER_DISTANCE = 15.0
"""Distance from the cubic, in scales, of an outlier. No torque of the public recordings is as far, though their noise
is not Gaussian; one nearer sample in a thousand adds less than a quarter to the variance of the noise."""

STAMPS = 5.0
"""Distance of an outlier, in units of what the unevenness of the stamps around explains."""

TOO_MANY = 0.02
"""Share of a column's samples beyond which they are not exceptions; such a column is left as it is."""

_QUANTILES, _OF_A_NORMAL = (0.5, 0.7), (0.6745, 1.0364)  # of the size of a standard normal variable
_CUBIC_ROUNDING = 1e-14  # of the largest value, what a constant signal seems to be from a cubic
_ROUNDING_SHARE = 1e-9  # of the largest value
_SAME_STAMP = 1e-9  # [s] to the one before
_LARGEST_GAP = 4.0  # of the samples around, in median periods: no cubic across a gap
_PASSES = 3
_SAMPLES_AT_ONCE = 20_000

AROUND = 6
"""Samples on each side that a change of position is compared with."""

LARGER = 5.0
"""Change of position over the largest of those around, from which on it is a jump."""

FASTEST = 2.0
"""The same over the recording's fast changes (their 95 % quantile)."""

STEPS = 10.0
"""Encoder steps of a jump at least."""

SLOW = 3.0
"""Encoder steps per sample below which a joint that moves stands still for some samples."""

UNEVEN = 5.0
"""Departure from the changes on both sides, over the usual one there, which shows that another joint jumps, too."""

NEAR_TURN = 0.02
"""Part of a turn within which a jump is a whole one."""

LONGEST_STEP = 4.0
"""Periods between two stamps from which on there is a gap, across which everything moves."""

LEFT_OUT = 5.5, 0.0275
"""Periods and time [s] on each side of a jump, the larger of them, that are left out: a hole so long is a gap."""

MOST_JUMPS = 0.02
"""Share of the samples from which on jumps are noise."""

Cause = Literal["zero", "turn", "rows"]


@dataclass(frozen=True, eq=False)
class CleanSignal:
    """A signal whose outliers are replaced."""

    values: FloatArray  # (N, n) with the cubic's values in place of outliers
    replaced: npt.NDArray[np.int64]  # (n,) number of samples that were
    left: npt.NDArray[np.int64]  # (n,) number of outliers in columns that have too many of them, which stay


def without_outliers(time: FloatArray, values: FloatArray) -> CleanSignal:
    """Replace the outliers of a signal by what their neighbours say.

    Args:
        time: (N,) [s]; repeated stamps are allowed.
        values: (N, n); a column with values that are not finite is left as it is.

    Stamps that do not rise are left to those who use the signal: nothing is replaced then.
    """
    clean = values.copy()
    replaced, left = np.zeros(values.shape[1], dtype=np.int64), np.zeros(values.shape[1], dtype=np.int64)
    if len(values) < 4 * NEIGHBOURS or not np.all(np.abs(time) <= STAMP.most):
        return CleanSignal(clean, replaced, left)
    # Repeated stamps have no cubic of their own; they are dropped again before anything is computed.
    kept = np.flatnonzero(np.concatenate([[True], np.diff(time) > _SAME_STAMP]))
    stamps = time[kept]
    if len(kept) < 4 * NEIGHBOURS or np.any(np.diff(stamps) <= 0):
        return CleanSignal(clean, replaced, left)
    weights = _weights_of_four(stamps)
    for column in np.flatnonzero(np.all(np.isfinite(values), axis=0)):
        signal = values[kept, column].astype(np.float64)
        with np.errstate(over="ignore", invalid="ignore"):  # absurd values are refused by those who use them
            outlying = _replace_outliers(stamps, weights, signal)
        rows = kept[outlying]
        if len(rows) > TOO_MANY * len(values):
            left[column] = len(rows)
        elif len(rows):
            replaced[column] = len(rows)
            clean[rows, column] = (
                signal[outlying] if len(kept) == len(values) else np.interp(time[rows], stamps, signal)
            )
    return CleanSignal(clean, replaced, left)


def _replace_outliers(time: FloatArray, weights: FloatArray, values: FloatArray) -> BoolArray:
    """Return which of the values (N,) are outliers; they are replaced in place."""
    outlying = np.zeros(len(values), dtype=bool)
    step = quantisation_step(values)
    floor = 0.0 if np.isnan(step) else step
    for _ in range(_PASSES):  # a large outlier hides a small one beside it
        distance = _distance_from_four(weights, values)
        scale = max(floor, _noise(distance, float(np.max(np.abs(values)))))
        suspects = np.flatnonzero(np.abs(distance) > 0.5 * OUTLIER_DISTANCE * scale)
        new = _confirmed(time, values, suspects, scale)
        if not new.any():
            break
        outlying |= new
    return outlying


def _noise(distance: FloatArray, largest: float) -> float:
    """Standard deviation of what is white in a signal, from its distances (N,) from a cubic, outliers apart.

    A signal at rest that shows no noise at all says nothing about the noise in motion. The larger of two quantiles
    counts, since noise in motion is larger than at rest.
    """
    sizes = np.abs(distance)
    sizes = sizes[sizes > _CUBIC_ROUNDING * largest]
    if len(sizes) == 0:
        return _ROUNDING_SHARE * largest
    noise = float(np.max(np.quantile(sizes, _QUANTILES) / _OF_A_NORMAL))
    return max(noise, _ROUNDING_SHARE * largest)


_SHIFTS = (-2, -1, 1, 2)


def _weights_of_four(time: FloatArray) -> FloatArray:
    """(4, N − 4) weights of the samples beside each one, two on either side, in the cubic through them."""
    at = {shift: time[2 + shift : len(time) - 2 + shift] - time[2:-2] for shift in _SHIFTS}
    weights = np.ones((len(_SHIFTS), len(time) - 4))
    for weight, shift in zip(weights, _SHIFTS, strict=True):
        for other in _SHIFTS:
            if other != shift:
                weight *= at[other] / (at[other] - at[shift])
    return weights


def _distance_from_four(weights: FloatArray, values: FloatArray) -> FloatArray:
    """(N,) distance of each sample from the cubic through two samples on either side; 0 at both ends."""
    distance = np.zeros(len(values))
    for weight, shift in zip(weights, _SHIFTS, strict=True):
        distance[2:-2] += weight * values[2 + shift : len(values) - 2 + shift]
    distance[2:-2] = values[2:-2] - distance[2:-2]
    return distance


def _confirmed(time: FloatArray, values: FloatArray, suspects: IntArray, scale: float) -> BoolArray:
    """Return which of the suspects are outliers, shortest runs first; they are replaced in `values`."""
    outlying = np.zeros(len(values), dtype=bool)
    for length in range(1, LONGEST_OUTLIER + 1):
        # A run of wrong samples may begin at a suspect or just before one.
        first = np.unique(suspects[:, None] - np.arange(length)) if len(suspects) else suspects
        first = first[(first >= NEIGHBOURS) & (first + length + NEIGHBOURS <= len(values))]
        for chunk in np.array_split(first, max(1, len(first) // _SAMPLES_AT_ONCE)):
            _confirm_runs(time, values, chunk, length, scale, outlying)
        suspects = suspects[~outlying[suspects]]
    return outlying


def _confirm_runs(
    time: FloatArray, values: FloatArray, first: IntArray, length: int, scale: float, confirmed: BoolArray
) -> None:
    """Test runs of `length` samples that begin at `first`; mark and replace the outliers among them, farthest first."""
    if len(first) == 0:
        return
    run = np.arange(length)
    spacings = np.diff(time)
    median = float(np.median(spacings))
    periods = spacings[first[:, None] + np.arange(-NEIGHBOURS, length + NEIGHBOURS - 1)]
    # No cubic goes across a gap.
    first, periods = (chosen[np.max(periods, axis=1) < _LARGEST_GAP * median] for chosen in (first, periods))
    if len(first) == 0:
        return
    around = np.concatenate([np.arange(-NEIGHBOURS, 0), np.arange(length, length + NEIGHBOURS)])
    stamps = time[first[:, None] + around]
    middle, width = stamps.mean(axis=1, keepdims=True), 0.5 * np.ptp(stamps, axis=1, keepdims=True)
    powers = np.arange(4)
    basis = ((stamps - middle) / width)[:, :, None] ** powers
    wanted = ((time[first[:, None] + run] - middle) / width)[:, :, None] ** powers
    neighbours = values[first[:, None] + around]
    spread, prediction = _fit_without_worst(basis, neighbours, wanted)
    distance = np.min(np.abs(values[first[:, None] + run] - prediction), axis=1)
    # A stamp that is off makes a good sample of a moving joint look wrong.
    slope = np.median(np.abs(np.diff(neighbours, axis=1) / np.diff(stamps, axis=1)), axis=1)
    by_stamps = slope * np.max(np.abs(periods - median), axis=1)
    outlying = distance > np.maximum(OUTLIER_DISTANCE * np.maximum(scale, spread), STAMPS * by_stamps)
    for number in np.flatnonzero(outlying)[np.argsort(-distance[outlying])]:
        there = first[number] + run
        # The same glitch also seems to begin a sample earlier or later: the farthest counts.
        if not confirmed[max(0, there[0] - 1) : there[-1] + 2].any():
            confirmed[there] = True
            values[there] = prediction[number]


def _fit_without_worst(basis: FloatArray, values: FloatArray, wanted: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Deviation (M,) of neighbours from cubics without the one without which they fit best, and its values (M, r).

    `basis` (M, k, 4) and `wanted` (M, r, 4) are powers of the times, `values` (M, k) those of the neighbours.
    """
    axes, factor = np.linalg.qr(basis)
    inverse = np.linalg.solve(factor, axes.swapaxes(1, 2))
    hat = axes @ axes.swapaxes(1, 2)
    residual = values - np.einsum("mij,mj->mi", hat, values)
    # 0 for a neighbour beyond a gap, through which the cubic goes whatever its value.
    leverage = np.maximum(1.0 - np.einsum("mii->mi", hat), _CUBIC_ROUNDING)
    # Leaving out neighbour j takes r_j² / (1 − h_j) from the sum of squares, and moves the cubic by its share of that.
    saved = residual**2 / leverage
    worst = np.argmax(saved, axis=1)
    every = np.arange(len(values))
    rest = np.maximum(0.0, np.sum(residual**2, axis=1) - saved[every, worst])
    coefficients = np.einsum("mij,mj->mi", inverse, values)
    coefficients -= inverse[every, :, worst] * (residual[every, worst] / leverage[every, worst])[:, None]
    freedom = values.shape[1] - 5
    return np.sqrt(rest / freedom), np.einsum("mri,mi->mr", wanted, coefficients)


@dataclass(frozen=True)
class PositionJump:
    """A jump."""

    joint: str  # name; of rows the one that jumps farthest
    row: int  # index of the first sample after it
    time: float  # its stamp [s]
    size: float  # [rad or m]
    cause: Cause  # a lost zero, a whole turn, or rows that are missing or stand twice


def position_jumps(
    time: FloatArray, joints: tuple[str, ...], position: FloatArray, ignored: BoolArray
) -> tuple[PositionJump, ...]:
    """The jumps of positions (N, n) [rad or m] at rising stamps (N,) [s].

    Rows that are `ignored` (N,) say nothing of the changes beside them.
    """
    count = len(time)
    if count < 4 * AROUND or not np.all(np.isfinite(position)):
        return ()
    steps = np.diff(time)
    period = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 0.0
    near = ignored[1:] | ignored[:-1] | (steps <= 0) | (steps > LONGEST_STEP * period)
    if not period > 0:
        return ()
    moved = np.diff(position, axis=0)
    change = np.abs(moved) * (period / np.where(steps > 0, steps, period))[:, None]
    excess = np.zeros_like(change)
    jumps = np.zeros_like(change, dtype=np.bool_)
    for column in range(len(joints)):
        own = change[:, column]
        inner = slice(AROUND, len(own) - AROUND)
        step = resolution(position[:, column])
        if not np.isfinite(step):
            continue
        # Of the changes on both sides of each.
        before, after = _largest_of(own[: -AROUND - 1], AROUND), _largest_of(own[AROUND + 1 :], AROUND)
        largest = np.maximum(before, after)
        least = np.maximum(LARGER * largest, STEPS * step)
        jumps[inner, column] = own[inner] > np.maximum(least, FASTEST * np.quantile(own, 0.95))
        # Rows that were not read anew for a while end in a jump, too.
        stood = (before > 0) != (after > 0)
        jumps[inner, column] &= ~stood | (largest < SLOW * step)
        signed = moved[:, column]
        turns = np.abs(np.diff(signed))
        usual = np.maximum(_largest_of(turns[: -AROUND - 1], AROUND - 1), _largest_of(turns[AROUND + 1 :], AROUND - 1))
        departure = np.abs(signed[inner] - 0.5 * (signed[AROUND - 1 : -AROUND - 1] + signed[AROUND + 1 : 1 - AROUND]))
        excess[inner, column] = departure / np.maximum(usual, 2.0 * step)
    jumps[near] = False
    rows = np.flatnonzero(jumps.any(axis=1))
    if len(rows) > MOST_JUMPS * count:
        return ()
    outliers = []
    for row in rows.tolist():
        column = int(np.argmax(np.where(jumps[row], excess[row], -1.0)))
        size = float(moved[row, column])
        whole_turns = size / (2.0 * np.pi)
        cause: Cause = "zero"
        if np.count_nonzero(excess[row] > UNEVEN) > 1:
            cause = "rows"
        elif round(whole_turns) and abs(whole_turns - round(whole_turns)) < NEAR_TURN:
            cause = "turn"
        outliers.append(PositionJump(joints[column], row + 1, float(time[row + 1]), size, cause))
    return tuple(outliers)


def _largest_of(values: FloatArray, count: int) -> FloatArray:
    """(N - count + 1,) the largest of each `count` consecutive values (N,)."""
    largest = values[: len(values) - count + 1].copy()  # 30 times as fast as the maximum of a sliding window view
    for shift in range(1, count):
        np.maximum(largest, values[shift : len(values) - count + 1 + shift], out=largest)
    return largest


def beside_jumps(time: FloatArray, jumps: tuple[PositionJump, ...]) -> BoolArray:
    """(N,) rows about the jumps, without which the recording has gaps there."""
    beside = np.zeros(len(time), dtype=np.bool_)
    if jumps:
        half = max(LEFT_OUT[0] * float(np.median(np.diff(time))), LEFT_OUT[1])
        for jump in jumps:
            middle = 0.5 * (time[jump.row - 1] + time[jump.row])
            beside |= np.abs(time - middle) <= half
    return beside
