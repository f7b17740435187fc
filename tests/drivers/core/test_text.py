"""Percentages as people write them; JSON that is none."""

from __future__ import annotations

import math
import re

import pytest
from each import each
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.text import DASH, LEAST_PERCENT, MOST_PERCENT, counted, parsed_json, percent_text, percentage_text


@each(
    ("ratio", "text"),
    [
        (0.0, "0 %"),
        (0.0034, "0.340 %"),
        (0.1234, "12.3 %"),
        (0.9996, "100 %"),
        (0.09996, "10.0 %"),
        (0.5, "50 %"),
        (1.0, "100 %"),
        (1.04, "104 %"),
        (12.3456, "1235 %"),
        (-0.02, "-2 %"),
        (1e-9, "< 0.001 %"),
        (1e9, "> 1000000 %"),
        (None, DASH),
        (math.nan, DASH),
        (math.inf, DASH),
    ],
)
def test_ratios_in_percent(ratio: float | None, text: str) -> None:
    assert percent_text(ratio) == text


@given(st.floats(LEAST_PERCENT, MOST_PERCENT, exclude_max=True), st.integers(2, 5))
def test_digits_are_kept_and_no_power_of_ten_is_written(value: float, digits: int) -> None:
    text = percentage_text(value, digits)
    assert re.fullmatch(r"\d+(\.\d+)?", text)
    assert float(text) == pytest.approx(value, rel=0.5 * 10 ** (1 - digits), abs=1e-9)
    assert percentage_text(-value, digits) == f"-{text}"


@pytest.mark.parametrize(
    ("text", "reason"), [("{", "Expecting"), ("[" * 100_000, "too deeply"), ("9" * 5_000, "digits"), ("", "Expecting")]
)
def test_what_is_no_json_is_a_value_error(text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        parsed_json(text)


def test_one_thing_is_no_plural() -> None:
    counts = 0, 1, 2, 1.0, 0.5, 1234567
    said = ["0 alarms", "1 alarm", "2 alarms", "1 alarm", "0.5 alarms", "1234567 alarms"]
    assert [counted(count, "alarm") for count in counts] == said
