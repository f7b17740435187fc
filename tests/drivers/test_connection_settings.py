from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field

from drivers.connection_settings import MOST_PROBLEMS, ConnectionSettings, Entries, read_settings
from drivers.core.errors import UsageError


class Sensor(ConnectionSettings):
    gain: float = Field(1.0, ge=-3, le=1e6, description="[V/A]")
    port: int = Field(0, ge=0, le=9)


class Bench(ConnectionSettings):
    sensors: Entries[Sensor] = ()
    by_name: dict[str, Sensor] = Field(default_factory=dict)


ANYTHING = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=5)
    | st.lists(st.integers(), max_size=2)
    | st.dictionaries(st.text(max_size=2), st.integers(), max_size=2)
)


@given(ANYTHING, st.sampled_from(["gain", "port"]))
def test_a_number_within_its_limits_is_accepted_and_all_else_refused(value: object, key: str) -> None:
    kinds, low, high = ((int, float), -3, 1e6) if key == "gain" else ((int,), 0, 9)
    fits = isinstance(value, kinds) and not isinstance(value, bool) and low <= value <= high
    keys = {"sensors": [{key: value}]}
    if fits:
        assert getattr(read_settings(Bench, keys, "test").sensors[0], key) == value
        return
    with pytest.raises(UsageError, match=rf"key 'sensors\[0\]\.{key}' of the test connection is") as caught:
        read_settings(Bench, keys, "test")
    words = "a number from -3 to 1000000 [V/A]" if key == "gain" else "an integer from 0 to 9"
    assert caught.value.hint == f"allowed: {words}"


def test_a_key_without_a_value_and_the_sessions_own_are_left_out() -> None:
    assert read_settings(Bench, {"sensors": None, "with": ["thermometer"]}, "test") == Bench()


def test_key_paths_lead_through_lists_and_mappings() -> None:
    keys = {"sensors": [{}, {"prot": 1}], "by_name": {"left": {"gain": True}, "right": 5}}
    with pytest.raises(UsageError) as caught:
        read_settings(Bench, keys, "test")
    assert caught.value.message == (
        "3 keys of the test connection are wrong: "
        "unknown key 'sensors[1].prot' (allowed: gain, port; did you mean 'port'?); "
        "'by_name.left.gain' is True (allowed: a number from -3 to 1000000 [V/A]); "
        "'by_name.right' is 5"
    )


def test_a_message_stays_readable_however_much_is_wrong() -> None:
    with pytest.raises(UsageError, match=rf"100 keys .*; and {100 - MOST_PROBLEMS} more$"):
        read_settings(Bench, {"sensors": [{"gain": "high"}] * 100}, "test")
