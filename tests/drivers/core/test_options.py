"""Options declared once: their checks, the texts of the command line, the signature and docstring of the API."""

from __future__ import annotations

import inspect
from contextlib import suppress
from dataclasses import KW_ONLY, dataclass, field

import numpy as np
import pytest
from each import each
from hypothesis import given
from hypothesis import strategies as st
from threadpoolctl import threadpool_info, threadpool_limits

from drivers.core.errors import UsageError
from drivers.core.options import (
    Options,
    argument,
    keywords_of,
    option,
    read_delay,
    read_names,
    same_named,
    spoken_in_a_shell,
)
from drivers.core.ranges import Range


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_a_delay_is_a_number_of_seconds(value):
    assert read_delay(repr(value), "--delay") == value


@given(st.text())
def test_any_text_is_a_finite_delay_or_refused(text):
    with suppress(UsageError):
        value = read_delay(text, "--delay")
        assert value is None or abs(value) < float("inf")


def test_auto_leaves_the_delay_open():
    assert read_delay("auto", "--delay") is None


@each("text", ["nan", "inf", "-inf", "", "soon", "1,2", "AUTO"])
def test_what_is_no_delay_is_refused(text):
    with pytest.raises(UsageError, match="neither 'auto' nor a number of seconds"):
        read_delay(text, "--delay")


@each(("text", "names"), [("a", ("a",)), ("a,b", ("a", "b")), (" a , b c ,", ("a", "b c"))])
def test_commas_separate_names(text, names):
    assert read_names(text, "--joints") == names


@each("text", ["", ",", " , "])
def test_an_option_without_a_name_is_refused(text):
    with pytest.raises(UsageError, match=r"--locked '.*' contains no name"):
        read_names(text, "--locked")


@dataclass(frozen=True)
class Grasp(Options):
    """Options of a test."""

    hand: str = field(metadata=argument("hand", "Which hand."))
    _: KW_ONLY
    force: float | None = option(None, "Force [N].", allowed=Range(0.0, 50.0, "N"), hint="10 is gentle")
    fingers: tuple[float, ...] = option((), "Angles [rad].", allowed=Range(0.0, 2.0, "rad"))
    style: str = option("pinch", "Style.", one_of=("pinch", "power"))
    joints: tuple[str, ...] = option((), "Joints.", read=read_names)


@keywords_of(Grasp)
def grasp(options: Grasp) -> Grasp:
    """Grasp something.

    Raises:
        UsageError: impossible.
    """
    return options


@each(
    ("given", "message"),
    [
        ({"force": 60.0}, r"^force 60 is not within 0 to 50 N.*10 is gentle"),
        ({"force": float("nan")}, "nan is not a finite number"),
        ({"fingers": (1.0, 3.0)}, "^fingers 3 is not within"),
        ({"style": "hook"}, "^style 'hook' does not exist.*pinch or power"),
        ({"joints": "thumb"}, "a list of joint names is needed"),
    ],
)
def test_a_value_that_is_not_allowed_is_refused_by_its_name(given, message):
    with pytest.raises(UsageError, match=message):
        grasp("left", **given)
    shown = message.replace("^", "--") if message.startswith("^") else message
    with spoken_in_a_shell(), pytest.raises(UsageError, match=shown):
        grasp("left", **given)


@keywords_of(Grasp)
def advise(options: Grasp) -> Grasp:
    """Refuse, with advice."""
    raise UsageError("--joints names nothing", hint=options.hand)


@each(
    ("hint", "typed"),
    [
        ("or give --force N", "or give force=N"),
        ("--style pinch or --force 3", 'style="pinch" or force=3'),
        ("leave it out: --joints a,b", 'leave it out: joints=["a", "b"]'),
        ("--repair sort, in Python repair=['sort']", "repair=['sort']"),
        ("see dynid grasp HAND --force 3", "see dynid grasp HAND --force 3"),
        ("--others stay", "--others stay"),
    ],
)
def test_advice_names_options_as_python_types_them(hint, typed):
    with pytest.raises(UsageError, match=r"^joints names nothing") as refused:
        advise(hint)
    assert refused.value.hint == typed


def test_a_function_has_the_arguments_and_the_texts_of_its_options():
    assert list(inspect.signature(grasp).parameters) == ["hand", "force", "fingers", "style", "joints"]
    assert grasp("left", force=10.0) == Grasp("left", force=10.0)
    with pytest.raises(TypeError):
        grasp()
    doc = inspect.getdoc(grasp)
    assert doc.index("    hand: Which hand.") < doc.index("    force: Force [N].") < doc.index("Raises:")


def test_another_dataclass_takes_the_values_of_the_same_names():
    assert same_named(Grasp("left", force=1.0), Grasp, hand="right") == Grasp("right", force=1.0)


def test_a_value_of_another_kind_is_refused_in_words():
    for values, words in (
        ({"force": "10"}, "force '10' is not a number"),
        ({"force": True}, "force True is not a number"),
        ({"style": 3}, "style 3 is not a text"),
    ):
        with pytest.raises(UsageError) as refused:
            grasp("left", **values)
        assert refused.value.message == words
    assert grasp("left", force=np.float32(2.0)).force == 2.0


def test_a_function_of_python_computes_with_its_own_numerical_settings_and_gives_the_callers_back():
    @dataclass
    class NoOptions(Options):
        pass

    def threads(_options: object = None) -> set[int]:
        seen.append(np.geterr()["under"])
        return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}

    seen: list[str] = []
    with threadpool_limits(2, "blas"), np.errstate(all="raise"):
        before = threads()
        assert keywords_of(NoOptions)(threads)() == {1}
        assert threads() == before == {2}
    assert seen == ["raise", "ignore", "raise"]
