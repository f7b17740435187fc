"""Rows as a page draws them: smallest and largest value of each channel over short times."""

from __future__ import annotations

from collections import deque

import numpy as np

from drivers.core.arrays import FloatArray

KEPT = 6000
"""Groups that a page gets when it is opened: a minute of 100 groups a second."""


class Envelope:
    """Smallest and largest values of groups of rows, as bytes for a page.

    A message is the number of groups n and of channels c (uint32 each), their first and last times (n, 2) float64, and
    smallest and largest values (n, 2, c) float32, little-endian.
    """

    def __init__(self) -> None:
        self._times: deque[FloatArray] = deque(maxlen=KEPT)
        self._values: deque[FloatArray] = deque(maxlen=KEPT)

    def add(self, rows: FloatArray, groups: int) -> bytes:
        """Group new rows (N, 1 + c), N ≥ 1, time first; the message of at most so many groups."""
        starts = np.unique(np.linspace(0, len(rows), min(groups, len(rows)), endpoint=False).astype(np.intp))
        ends = np.append(starts[1:], len(rows)) - 1
        times = np.column_stack([rows[starts, 0], rows[ends, 0]])
        values = np.stack([np.fmin.reduceat(rows[:, 1:], starts), np.fmax.reduceat(rows[:, 1:], starts)], axis=1)
        self._times.extend(times)
        self._values.extend(values)
        return _message(times, values)

    @property
    def history(self) -> bytes | None:
        """The message of all groups that are kept; None without any."""
        return _message(np.array(self._times), np.array(self._values)) if self._times else None


def _message(times: FloatArray, values: FloatArray) -> bytes:
    head = np.array([len(times), values.shape[2]], dtype="<u4")
    limit = float(np.finfo(np.float32).max)
    return head.tobytes() + times.astype("<f8").tobytes() + np.clip(values, -limit, limit).astype("<f4").tobytes()
