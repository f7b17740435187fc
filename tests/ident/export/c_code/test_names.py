"""C names and comments of any robot, however it is called."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from each import each
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.errors import UsageError
from ident.export.c_code.names import comment_text, identifier, source_paths


@given(st.text())
def test_every_name_gives_an_identifier(name):
    word = identifier(name)
    assert re.fullmatch(r"[a-z][a-z0-9_]*", word)
    assert not re.match(r"(is|to)[a-z]", word)


@each(
    ("name", "expected"),
    [
        ("UR5e", "ur5e"),
        ("KUKA LBR iiwa-14", "kuka_lbr_iiwa_14"),
        ("7bot", "arm_7bot"),
        ("机器人", "arm"),
        ("Bückarm", "buckarm"),
        ("_x_", "x"),
        ("tower", "arm_tower"),
        ("int", "int"),
    ],
)
def test_identifiers(name, expected):
    assert identifier(name) == expected


@given(st.text(alphabet=st.one_of(st.sampled_from("*/?\\\n\u202e a"), st.characters())))
def test_no_text_ends_a_comment_or_opens_another(text):
    shown = comment_text(text)
    assert not any(mark in f" {shown} " for mark in ("*/", "/*", "??", "\\", "\n", "\u202e"))


@each("path", ["arm", "arm.c", "arm.h"])
def test_one_name_for_both_files(path):
    assert source_paths(Path("out") / path) == (Path("out/arm.h"), Path("out/arm.c"))


def test_a_dot_in_the_name_stays():
    assert source_paths(Path("arm.v2")) == (Path("arm.v2.h"), Path("arm.v2.c"))


@each("path", ['a"b', "a\nb", "-arm", "..", "", "mein arm"])
def test_names_that_no_include_can_hold_are_refused(path):
    with pytest.raises(UsageError, match="is not a valid name for C files"):
        source_paths(Path(path))
