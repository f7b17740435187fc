"""Runs of true values."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.arrays import true_runs


@given(st.lists(st.booleans(), max_size=30))
def test_runs_are_what_is_true_and_apart(values: list[bool]) -> None:
    runs = true_runs(np.array(values, dtype=np.bool_))
    assert [index for start, stop in runs for index in range(start, stop)] == list(np.flatnonzero(values))
    assert all(start < stop for start, stop in runs)
    assert all(stop < later for (_, stop), (later, _) in pairwise(runs))
