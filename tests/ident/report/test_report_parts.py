"""Parts of the HTML report: numbers as text, series on a page, what residuals look like."""

from __future__ import annotations

import re
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from each import each
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from torque_series import series

from ident.model.parameters import JOINT_SYMBOLS
from ident.report.figures.figures import KIND_STYLES
from ident.report.figures.traces import LONGEST_PAUSE, envelope_indices, lay_out
from ident.report.sections.residuals import joint_residual
from ident.views.number_text import number, with_error


@given(st.lists(st.tuples(st.floats(-1e9, 1e9), st.integers(0, 50)), max_size=6))
def test_shown_time_only_grows(segments: list[tuple[float, int]]) -> None:
    parts = [series(start, samples) for start, samples in segments]
    timeline = lay_out([part.time for part in parts])
    shown = [part.time + offset for part, offset in zip(parts, timeline.offsets, strict=True) if len(part.time)]
    if not shown:
        return
    assert shown[0][0] == 0.0
    for before, after in pairwise(shown):
        assert -1e-6 <= after[0] - before[-1] <= LONGEST_PAUSE + 1e-6


@given(
    arrays(np.float64, st.integers(0, 3000), elements=st.one_of(st.floats(-1e6, 1e6), st.just(float("nan")))),
    st.integers(4, 400),
)
def test_envelope_keeps_the_extremes(signal: np.ndarray[Any, np.dtype[np.float64]], points: int) -> None:
    kept = envelope_indices(signal, points)
    assert np.all(np.diff(kept) > 0)
    # two a bin, both ends, and at most one gap a bin
    assert len(kept) <= max(4, points) + 2 + points // 2
    if np.isfinite(signal).any():
        assert np.nanmax(signal[kept]) == np.nanmax(signal)
        assert np.nanmin(signal[kept]) == np.nanmin(signal)


def test_residuals_white_and_not() -> None:
    white = joint_residual([series(samples=20_000)], 0, 40)
    assert white.autocorrelation[0] == 1.0
    assert white.outside < 0.2
    assert white.std == pytest.approx(0.1, rel=0.05)
    assert abs(white.excess_kurtosis) < 0.2
    assert np.sum(white.density) * 0.2 == pytest.approx(1.0)
    part = series(samples=5000)
    part.measured[0] = part.predicted[0] + np.sin(part.time)
    assert joint_residual([part], 0, 40).outside == 1.0


def test_autocorrelation_is_the_textbook_one_within_segments() -> None:
    parts = [series(samples=200), series(5.0, 150, seed=3)]
    parts[0].used[50:60] = False
    found = joint_residual(parts, 1, 20)
    centred = [np.where(part.used, part.measured[1] - part.predicted[1] - found.mean, 0.0) for part in parts]
    products = [sum(float(e[lag:] @ e[: len(e) - lag]) for e in centred) for lag in range(20)]
    np.testing.assert_allclose(found.autocorrelation, np.array(products) / products[0], atol=1e-12)


@given(st.floats(-1e300, 1e300), st.integers(2, 8))
def test_numbers_keep_their_digits(value: float, digits: int) -> None:
    text = number(value, digits).replace("−", "-")
    text = re.sub(r"·10(.*)", lambda match: "e" + match[1].translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")), text)
    assert float(text) == pytest.approx(value, rel=0.51 * 10.0 ** (1 - digits), abs=0.0)


@each(
    ("value", "std", "text"),
    [
        (1.23456, 0.00105, "1.2346 ± 0.0021"),
        (-12.3, 2.0, "−12.3 ± 3.9"),
        (1234.4, 30.0, "1234 ± 59"),
        (2.5e-5, 1e-6, "(2.50 ± 0.20)·10⁻⁵"),
        (0.0, 0.5, "0.00 ± 0.98"),
        (None, 1.0, "–"),
        (1.0, None, "1.000 ± –"),
        (float("nan"), 1.0, "–"),
    ],
)
def test_values_are_cut_at_their_error(value: float | None, std: float | None, text: str) -> None:
    assert with_error(value, std) == text


def test_every_kind_of_base_parameter_has_a_style() -> None:
    """Those of the shapes' sensitivities are columns of a fit, never parameters of a result."""
    assert set(KIND_STYLES) == {"inertial", "coupling", *JOINT_SYMBOLS} - {"exponent", "stribeck_velocity"}
