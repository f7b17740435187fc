"""Extremes within a moving window."""

from __future__ import annotations

import numpy as np

from daq.recording.quality.windows import least_within


def test_the_least_of_every_window_as_there_is() -> None:
    generator = np.random.default_rng(0)
    for before, after in ((0, 0), (3, 0), (0, 4), (2, 5), (40, 9)):
        values = generator.normal(size=(2, 30))
        expected = [[row[max(0, i - before) : i + after + 1].min() for i in range(30)] for row in values]
        np.testing.assert_array_equal(least_within(values, before, after), expected)
        flags = values > -1.0
        assert np.array_equal(~least_within(~flags, after, before), _reached(flags, after, before))


def _reached(flags: np.ndarray, before: int, after: int) -> np.ndarray:
    return np.array([[row[max(0, i - before) : i + after + 1].any() for i in range(len(row))] for row in flags])
