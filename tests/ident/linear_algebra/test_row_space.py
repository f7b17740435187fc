"""What a system determines does not depend on units."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ident.linear_algebra.independent_columns import DETERMINED, row_space


@given(seed=st.integers(0, 2**32 - 1))
def test_what_is_determined_does_not_depend_on_units(seed: int) -> None:
    generator = np.random.default_rng(seed)
    system = generator.normal(size=(4, 4)) @ generator.integers(-1, 2, size=(4, 7))
    found, in_units = row_space(system), row_space(system * 10.0 ** generator.uniform(-4, 4, 7))
    np.testing.assert_allclose(in_units.shares, found.shares, rtol=0, atol=1e-9)
    rank = np.linalg.matrix_rank(system)
    for column, share in enumerate(found.shares):
        determined = np.linalg.matrix_rank(np.delete(system, column, axis=1)) < rank
        assert determined == (share >= DETERMINED)
