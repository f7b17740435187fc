from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.connection_keys import ConnectionKeys
from drivers.errors import UsageError

KEYS = ConnectionKeys("the test connection")
ANYTHING = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=5)
    | st.lists(st.integers(), max_size=2)
    | st.dictionaries(st.text(max_size=2), st.integers(), max_size=2)
)


@given(ANYTHING)
def test_a_number_within_its_limits_is_taken_and_all_else_refused(value: object) -> None:
    fits = isinstance(value, int | float) and not isinstance(value, bool) and -3 <= value <= 1e6
    if fits:
        found = KEYS.number("rate", value, -3, 1e6, "a number")
        assert isinstance(found, float)
        assert math.isfinite(found)
        assert found == value
    else:
        with pytest.raises(UsageError, match="key 'rate' of the test connection is"):
            KEYS.number("rate", value, -3, 1e6, "a number")


@given(ANYTHING)
def test_a_whole_number_within_its_limits_is_taken_and_all_else_refused(value: object) -> None:
    if isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= 9:
        assert KEYS.whole("port", value, 0, 9, "0 to 9") == value
    else:
        with pytest.raises(UsageError) as caught:
            KEYS.whole("port", value, 0, 9, "0 to 9")
        assert caught.value.hint == "allowed: 0 to 9"
        assert caught.value.message.endswith("is missing") is (value is None)
