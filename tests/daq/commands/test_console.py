"""What commands print: strict JSON, and tables that survive a pipe."""

from __future__ import annotations

import json
import math

from each import each
from hypothesis import given, settings
from hypothesis import strategies as st

from daq.commands.console import cell, print_json, print_table

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)


def refuse(constant: str) -> None:
    raise AssertionError(f"{constant} is not JSON")


def same(read, given) -> bool:
    if isinstance(given, float):
        return read is None if not math.isfinite(given) else read == given
    if isinstance(given, dict):
        return set(read) == set(given) and all(same(read[key], given[key]) for key in given)
    if isinstance(given, (list, tuple)):
        return len(read) == len(given) and all(same(a, b) for a, b in zip(read, given, strict=True))
    return read == given


@settings(max_examples=25)
@given(content=JSON)
def test_printed_json_is_strict_and_nothing_is_lost(content):
    import contextlib
    import io

    with contextlib.redirect_stdout(io.StringIO()) as out:
        print_json(content)
    assert same(json.loads(out.getvalue(), parse_constant=refuse), content)


def test_numbers_as_keys_and_tuples(capsys):
    print_json({1: (1.5, math.nan, {"τ": -math.inf})})
    assert json.loads(capsys.readouterr().out) == {"1": [1.5, None, {"τ": None}]}


@each(
    ("value", "shown"),
    [
        (None, "–"),
        (math.nan, "–"),
        (math.inf, "–"),
        (1.23456789, "1.235"),
        (123456.0, "1.235e+05"),
        (0.0, "0"),
        (12345678, "12345678"),
        ("text", "text"),
        (True, "True"),
    ],
)
def test_cells(value, shown):
    assert cell(value) == shown


def test_tables_in_a_pipe_keep_every_column_and_markup_as_text(capsys):
    names = [f"column_{number}" for number in range(9)]
    print_table("a title", names, [["[red]x[/red]", *range(8)], ["y" * 30, None, 1.23456789, *range(6)]])
    out = capsys.readouterr().out
    assert "a title" in out
    for name in names:
        assert name in out
    assert "[red]x[/red]" in out
    assert "y" * 30 in out
    assert "1.235" in out
    assert "–" in out
    assert "\x1b[" not in out


def test_an_empty_table_has_its_headers(capsys):
    print_table("nothing", ["name", "value"], [])
    assert "name" in capsys.readouterr().out


def test_tables_command_no_terminal(capsys):
    print_table("a\x1b[2J", ["b\x07"], [["c\x9b31m"]])
    out = capsys.readouterr().out
    assert "a\\u001b[2J" in out
    assert "b\\u0007" in out
    assert "c\\u009b31m" in out
