"""Low-pass filters' sections against SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal

from ident.signals.filter_modes import low_pass_sections


@pytest.mark.parametrize("ripple", [0.0, 0.05, 1.0])
def test_sections_are_scipys(ripple: float) -> None:
    frequencies = 2.0 * np.pi * np.linspace(0.0, 0.499, 50)
    for order in range(1, 11):
        for cutoff in (0.02, 0.1, 0.25, 0.45):
            own = low_pass_sections(order, cutoff, ripple)
            design = scipy.signal.cheby1(order, ripple, 2 * cutoff, output="sos") if ripple else None
            theirs = scipy.signal.butter(order, 2 * cutoff, output="sos") if design is None else design
            assert own.shape == theirs.shape
            if order % 2 == 0:  # with an odd order SciPy pairs the real pole's zeros with others
                np.testing.assert_allclose(own, theirs, rtol=1e-13, atol=1e-15)
            responses = [scipy.signal.sosfreqz(sections, frequencies)[1] for sections in (own, theirs)]
            np.testing.assert_allclose(*responses, rtol=0, atol=1e-11)
