"""Derivatives of uniform signals."""

from __future__ import annotations

import numpy as np
from each import each

from ident.signals.segments import central_difference


@each("rate", [50.0, 125.0, 1000.0, 5000.0])
def test_central_difference_of_a_sinusoid(rate: float) -> None:
    frequency = 2.0
    time = np.arange(int(1.3 * rate)) / rate
    omega = 2 * np.pi * frequency
    rows = np.stack([np.sin(omega * time + phase) for phase in (0, 1, 2)])
    derivative = central_difference(rows, rate)
    exact = np.stack([omega * np.cos(omega * time + phase) for phase in (0, 1, 2)])
    gain = np.sin(omega / rate) / (omega / rate)
    np.testing.assert_allclose(derivative[:, 1:-1], gain * exact[:, 1:-1], atol=1e-8)
    ends = np.abs(derivative - exact)[:, [0, -1]]
    # One-sided differences of second order: h²/3 times the third derivative, plus their next term.
    assert (ends <= omega * ((omega / rate) ** 2 / 3 + (omega / rate) ** 3 / 4 + 1e-9)).all()
    assert (np.abs(derivative).max(axis=1) > omega / 2).all()  # the last joint too


def test_central_difference_of_a_parabola_is_exact_at_the_ends() -> None:
    time = np.linspace(0, 1, 101)
    rows = np.stack([3 * time**2 - time, time])
    np.testing.assert_allclose(central_difference(rows, 100), np.stack([6 * time - 1, np.ones(101)]), atol=1e-11)
