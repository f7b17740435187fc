"""Texts of options."""

from __future__ import annotations

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.errors import UsageError
from ident.commands.options import delay_option, names_option


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_a_delay_is_a_number_of_seconds(value):
    assert delay_option(repr(value)) == value


@given(st.text())
def test_any_text_is_a_finite_delay_or_refused(text):
    with suppress(UsageError):
        value = delay_option(text)
        assert value is None or abs(value) < float("inf")


def test_auto_leaves_the_delay_open():
    assert delay_option("auto") is None


@pytest.mark.parametrize("text", ["nan", "inf", "-inf", "", "soon", "1,2", "AUTO"])
def test_what_is_no_delay_is_refused(text):
    with pytest.raises(UsageError, match="neither 'auto' nor a number of seconds"):
        delay_option(text)


@pytest.mark.parametrize(
    ("text", "names"), [(None, None), ("a", ("a",)), ("a,b", ("a", "b")), (" a , b c ,", ("a", "b c"))]
)
def test_commas_separate_names(text, names):
    assert names_option(text, "--joints") == names


@pytest.mark.parametrize("text", ["", ",", " , "])
def test_an_option_without_a_name_is_refused(text):
    with pytest.raises(UsageError, match=r"--locked '.*' holds no name"):
        names_option(text, "--locked")
