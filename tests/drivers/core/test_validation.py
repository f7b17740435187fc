from __future__ import annotations

import re

import pytest
import yaml
from each import each
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, ValidationError, create_model

from drivers.core.validation import load_yaml, schema_problems

PIECES = list("\n:-a1'\"[]{},#µ") + ["  ", "- ", ": ", "&a ", "*a", "!!int ", "a: |\n", "- >-\n"]


def outcome(text: str, patch: pytest.MonkeyPatch, *, compiled: bool) -> object:
    patch.setattr(yaml, "__with_libyaml__", compiled)
    try:
        return load_yaml(text)
    except (yaml.YAMLError, RecursionError) as error:
        return str(error)


@pytest.mark.skipif(not yaml.__with_libyaml__, reason="PyYAML without libyaml")
@given(st.lists(st.sampled_from(PIECES), max_size=30).map("".join))
def test_the_compiled_parser_reads_and_refuses_as_the_plain_one(text: str) -> None:
    with pytest.MonkeyPatch.context() as patch:
        assert outcome(text, patch, compiled=True) == outcome(text, patch, compiled=False)


@each("opening", ["[", "- ", "{a: "])
def test_deep_nesting_is_an_error_and_no_crash(opening: str) -> None:
    with pytest.raises(RecursionError):
        load_yaml(opening * 100_000)


class Part(BaseModel):
    size: float = 1.0


@pytest.mark.parametrize("kind", [tuple[float, float], tuple[float, ...], list[int], dict[str, int], Part])
def test_messages_speak_of_files_and_not_of_python(kind: type) -> None:
    root = create_model("Root", key=kind)
    with pytest.raises(ValidationError) as caught:
        root.model_validate({"key": 3})
    (problem,) = schema_problems(caught.value, root)
    assert re.fullmatch("found 3, but it should be a (list|mapping of keys)", problem.message)
