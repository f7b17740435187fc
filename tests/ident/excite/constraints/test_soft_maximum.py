"""The soft maximum: a bound, its derivatives, and no overflow."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ident.excite.constraints.soft_maximum import soft_maximum


@given(arrays(np.float64, (3, 9), elements=st.floats(-1e6, 1e6)), st.floats(1e-3, 1e6))
def test_between_the_maximum_and_log_n_above_it(values, sharpness):
    bound, weights = soft_maximum(values, sharpness)
    largest = values.max(axis=1)
    rounding = 1e-9 * (1.0 + np.abs(largest))
    assert np.all(bound >= largest)
    assert np.all(bound <= largest + np.log(9) / sharpness + rounding)
    assert np.all(weights >= 0)
    assert np.allclose(weights.sum(axis=1), 1.0)


def test_weights_are_the_derivatives():
    values = np.random.default_rng(1).standard_normal((2, 3, 5))
    _, weights = soft_maximum(values, 4.0)
    for index in np.ndindex(values.shape):
        step = np.zeros_like(values)
        step[index] = 1e-6
        difference = (soft_maximum(values + step, 4.0)[0] - soft_maximum(values - step, 4.0)[0])[index[:2]] / 2e-6
        assert np.isclose(difference, weights[index], atol=1e-8)


def test_equal_values_share_the_weight():
    bound, weights = soft_maximum(np.full(4, 7.0), 10.0)
    assert np.isclose(bound, 7.0 + np.log(4) / 10.0)
    assert np.allclose(weights, 0.25)
