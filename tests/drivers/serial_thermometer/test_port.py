"""Lines of a thermometer: whatever bytes come, in whatever pieces, the same temperatures and counts come out."""

from __future__ import annotations

import math
from contextlib import suppress

import pytest
from each import each
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.errors import UsageError
from drivers.serial_thermometer.driver import RowAssembler
from drivers.serial_thermometer.port import (
    LONGEST_LINE,
    NO_MATCH,
    NOT_A_NUMBER,
    OUT_OF_RANGE,
    TOO_LONG,
    LineParser,
    ThermometerReading,
)
from drivers.serial_thermometer.settings import ThermometerSettings, parse_settings

JOINTS = ("shoulder", "elbow", "wrist")
KEYS: dict[str, object] = {
    "url": "/dev/ttyUSB0",
    "pattern": r"T(?P<channel>\w+)=(?P<value>\S+)",
    "channels": {1: "shoulder", "b": "wrist"},
    "rate": 5,
}


def settings(**changes: object) -> ThermometerSettings:
    return parse_settings(KEYS | changes, JOINTS)


def fed(parser: LineParser, data: bytes, cuts: list[int] | None = None) -> list[tuple[str, float]]:
    """Readings of a stream cut into pieces; the first line end lets the parser begin."""
    readings: list[ThermometerReading] = []
    at = 0
    whole = b"\n" + data
    for cut in [*sorted(cuts or []), len(whole)]:
        readings += parser.feed(whole[at : max(at, cut)])
        at = max(at, cut)
    return [(reading.joint, reading.value) for reading in readings]


@given(values=st.lists(st.floats(-60, 250), min_size=1, max_size=20), cuts=st.lists(st.integers(0, 200)))
def test_what_was_written_is_read_however_it_is_cut(values: list[float], cuts: list[int]) -> None:
    data = b"".join(b"T%d=%s\r\n" % (1, repr(value).encode()) for value in values)
    assert fed(LineParser(settings()), data, cuts) == [("shoulder", value) for value in values]


@given(data=st.binary(max_size=4000), cuts=st.lists(st.integers(0, 4000), max_size=20))
def test_any_bytes_give_the_same_whatever_the_pieces(data: bytes, cuts: list[int]) -> None:
    whole, pieces = LineParser(settings()), LineParser(settings())
    readings = fed(whole, data)
    assert fed(pieces, data, cuts) == readings
    assert pieces.rejected == whole.rejected
    assert pieces.unknown == whole.unknown
    assert all(-60.0 <= value <= 250.0 for _, value in readings)


def test_garbage_does_not_hide_the_line_behind_it() -> None:
    assert fed(LineParser(settings()), b"\xff\x00\x80" * 700 + b"\nT1=20\n") == [("shoulder", 20.0)]


@each(
    ("line", "why"),
    [
        (b"hello", NO_MATCH),
        (b"T1=", NO_MATCH),
        (b"T1=warm", NOT_A_NUMBER),
        (b"T1=nan", NOT_A_NUMBER),
        (b"T1=inf", NOT_A_NUMBER),
        (b"T1=1_0", NOT_A_NUMBER),
        (b"T1=1.2.3", NOT_A_NUMBER),
        (b"T1=--", NOT_A_NUMBER),
        (b"T1=-127.0", OUT_OF_RANGE),
        (b"T1=1e999", OUT_OF_RANGE),
        (b"T1=" + b"1" * LONGEST_LINE, TOO_LONG),
    ],
)
def test_what_is_no_temperature_is_counted_by_its_reason(line: bytes, why: str) -> None:
    parser = LineParser(settings())
    assert fed(parser, line + b"\nT1=21\n") == [("shoulder", 21.0)]
    assert parser.rejected == {why: 1}
    told = parser.take_rejected()
    assert told.startswith(f"1 line ignored: 1 {why}")
    assert parser.take_rejected() == ""


def test_one_sensor_without_a_value_does_not_silence_the_others() -> None:
    parser = LineParser(settings())
    assert fed(parser, b"T1=-- Tb=22,5 T9=3\n") == [("wrist", 22.5)]
    assert parser.rejected == {NOT_A_NUMBER: 1}
    assert parser.unknown == {"9"}


def test_the_rest_of_a_line_that_was_under_way_is_not_read() -> None:
    parser = LineParser(settings(pattern=r"(?P<channel>\d+)=(?P<value>\S+)"))
    assert parser.feed(b"1=20\n") == []  # of 21=20, perhaps
    assert [reading.value for reading in parser.feed(b"1=22\n")] == [22.0]
    parser.feed(b"1=2")
    parser.restart(cut=True)
    assert sum(parser.rejected.values()) == 1
    assert parser.feed(b"5\n") == []


@each(("unit", "text", "celsius"), [("degC", "37", 37.0), ("degF", "98.6", 37.0), ("K", "310.15", 37.0)])
def test_units_are_converted(unit: str, text: str, celsius: float) -> None:
    ((_, value),) = fed(LineParser(settings(unit=unit)), f"T1={text}\n".encode())
    assert value == pytest.approx(celsius, abs=1e-9)


@each(
    ("change", "said"),
    [
        ({"url": None}, "'url' .* is missing"),
        ({"url": 7}, "'url' .* is 7"),
        ({"pattern": "("}, "not a regular expression"),
        ({"pattern": r"T(?P<channel>\d)"}, "lacks named groups: value"),
        ({"pattern": r"(\d)=(\d)"}, "lacks named groups: channel, value"),
        ({"channels": {}}, "'channels'"),
        ({"channels": {1: "knee"}}, "which is not a joint"),
        ({"channels": {1: "elbow", 2: "elbow"}}, "two channels"),
        ({"channels": {1: "elbow", "1": "wrist"}}, "channel 1 is named twice"),
        ({"channels": {True: "elbow"}}, "channel True is neither"),
        ({"rate": 0}, "'rate'"),
        ({"rate": math.nan}, "'rate'"),
        ({"rate": None}, "'rate' .* is missing"),
        ({"baudrate": 9600.0}, "'baudrate'"),
        ({"baudrate": True}, "'baudrate'"),
        ({"unit": "R"}, "'unit'"),
        ({"required": "yes"}, "'required'"),
        ({"range": [100, 0]}, "'range'"),
        ({"range": [-300, 0]}, "'range'"),
        ({"range": [0, True]}, r"'range\[1\]' .* is True"),
        ({"range": "warm"}, "'range'"),
        ({"timeout": math.inf}, "'timeout'"),
        ({"baud": 9600}, "unknown key 'baud' .* did you mean 'baudrate'"),
    ],
)
def test_wrong_keys_are_named(change: dict[str, object], said: str) -> None:
    with pytest.raises(UsageError, match=said):
        settings(**change)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=10),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5) | st.integers(), inner, max_size=3),
    max_leaves=5,
)


@given(key=st.sampled_from([*KEYS, "baudrate", "unit", "range", "required", "timeout", "with", "x"]), value=JSON)
def test_any_value_is_taken_or_refused_in_words(key: str, value: object) -> None:
    with suppress(UsageError):
        assert settings(**{key: value}).rate > 0


@given(st.lists(st.tuples(st.sampled_from(JOINTS), st.floats(0, 100)), max_size=30))
def test_rows_hold_every_reading_once_and_in_order(readings: list[tuple[str, float]]) -> None:
    assembler = RowAssembler(JOINTS)
    rows = []
    for number, (joint, value) in enumerate(readings):
        rows += assembler.add(float(number), ThermometerReading(0, joint, value))
    rows += assembler.flush(before=math.inf)
    times = [when for when, _ in rows]
    assert times == sorted(set(times))
    for column, joint in enumerate(JOINTS):
        assert [row[column] for _, row in rows if not math.isnan(row[column])] == [v for j, v in readings if j == joint]
    assert not any(all(math.isnan(value) for value in row) for _, row in rows)
