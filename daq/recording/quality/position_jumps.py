"""Positions that jump between two samples whose stamps go on: a lost zero, a turn that wraps, rows that are missing.

A joint cannot move between two samples by many times what it moves between those around. Where several joints jump at
once, rows are missing there or stand twice; where one does, its encoder lost counts, or its angle was wrapped.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from daq.recording.quality.quantisation import resolution
from drivers.core.arrays import BoolArray, FloatArray

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


@dataclass(frozen=True)
class PositionJump:
    """A jump.

    Attributes:
        joint: name; of rows the one that jumps farthest.
        row: index of the first sample after it.
        time: its stamp [s].
        size: [rad or m].
        cause: a lost zero, a whole turn, or rows that are missing or stand twice.
    """

    joint: str
    row: int
    time: float
    size: float
    cause: Cause


def position_jumps(
    time: FloatArray, joints: tuple[str, ...], position: FloatArray, ignored: BoolArray
) -> tuple[PositionJump, ...]:
    """The jumps of positions.

    Args:
        time: (N,) [s], rising.
        joints: (n,) names.
        position: (N, n) [rad or m].
        ignored: (N,) rows that say nothing of the changes beside them.
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
        # The change itself stands in the middle of its window.
        windows = sliding_window_view(own, 2 * AROUND + 1)
        others = np.delete(windows, AROUND, axis=1)
        inner = slice(AROUND, len(own) - AROUND)
        step = resolution(position[:, column])
        if not np.isfinite(step):
            continue
        least = np.maximum(LARGER * others.max(axis=1), STEPS * step)
        jumps[inner, column] = own[inner] > np.maximum(least, FASTEST * np.quantile(own, 0.95))
        # Rows that were not read anew for a while end in a jump, too.
        stood = (others[:, :AROUND].max(axis=1) > 0) != (others[:, AROUND:].max(axis=1) > 0)
        jumps[inner, column] &= ~stood | (others.max(axis=1) < SLOW * step)
        signed = sliding_window_view(moved[:, column], 2 * AROUND + 1)
        usual = np.abs(np.diff(signed, axis=1))
        usual = np.delete(usual, [AROUND - 1, AROUND], axis=1).max(axis=1)
        departure = np.abs(signed[:, AROUND] - 0.5 * (signed[:, AROUND - 1] + signed[:, AROUND + 1]))
        excess[inner, column] = departure / np.maximum(usual, 2.0 * step)
    jumps[near] = False
    rows = np.flatnonzero(jumps.any(axis=1))
    if len(rows) > MOST_JUMPS * count:
        return ()
    found = []
    for row in rows.tolist():
        column = int(np.argmax(np.where(jumps[row], excess[row], -1.0)))
        size = float(moved[row, column])
        turns = size / (2.0 * np.pi)
        cause: Cause = "zero"
        if np.count_nonzero(excess[row] > UNEVEN) > 1:
            cause = "rows"
        elif round(turns) and abs(turns - round(turns)) < NEAR_TURN:
            cause = "turn"
        found.append(PositionJump(joints[column], row + 1, float(time[row + 1]), size, cause))
    return tuple(found)


def beside_jumps(time: FloatArray, jumps: tuple[PositionJump, ...]) -> BoolArray:
    """(N,) rows about the jumps, without which the recording has gaps there."""
    beside = np.zeros(len(time), dtype=np.bool_)
    if jumps:
        half = max(LEFT_OUT[0] * float(np.median(np.diff(time))), LEFT_OUT[1])
        for jump in jumps:
            middle = 0.5 * (time[jump.row - 1] + time[jump.row])
            beside |= np.abs(time - middle) <= half
    return beside
