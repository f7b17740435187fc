"""The figures that studies/recording/lossless.py prints."""

from __future__ import annotations

import os
import time

import numpy as np
import pytest

from studies.recording import lossless


def clock(*ticks: int) -> np.ndarray:
    return np.array(ticks) / lossless.RATE


def test_readers_are_counted_between_the_same_two_moments():
    readers = (clock(10, 11, 12, 13, 14, 15, 16), clock(0, 0, 12, 12, 15, 18), clock(11, 12, 13, 14))
    first, last = lossless.common_span(readers)
    assert (first, last) == (12, 14)
    # A tick that was not read counts, wherever it lies; a stamp of 0 is that of a reader without data yet.
    assert lossless.count(readers[0], first, last) == {
        "expected": 3, "read": 3, "lost": 0, "gaps": 0, "longest_gap": 0, "twice": 0,
    }  # fmt: skip
    assert lossless.count(readers[1], first, last) == {
        "expected": 3, "read": 1, "lost": 2, "gaps": 1, "longest_gap": 2, "twice": 1,
    }  # fmt: skip


def test_readers_that_never_met_are_not_compared():
    with pytest.raises(SystemExit, match="at the same time"):
        lossless.common_span([clock(1, 2, 3), clock(5, 6, 7)])
    with pytest.raises(SystemExit, match="read nothing"):
        lossless.common_span([clock(1, 2, 3), clock(0, 0)])


def test_shares_of_a_core_and_their_sum():
    assert lossless.shares({"a": 1.0, "b": 2.0}, {"a": 2.0, "b": 4.5}, 5.0) == {"a": 0.2, "b": 0.5, "sum": 0.7}
    before = time.process_time()
    while time.process_time() - before < 0.05:  # of the processor's own, so that no stall shortens it
        pass
    assert lossless.cpu_seconds(os.getpid()) == pytest.approx(time.process_time(), abs=0.05)
