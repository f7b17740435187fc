"""YAML that people write: no key twice, every unreadable value with its line, validation errors in the file's words."""

from __future__ import annotations

import re
import reprlib
import types
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

import yaml
from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails
from yaml.composer import Composer
from yaml.constructor import SafeConstructor
from yaml.resolver import Resolver

from drivers.core.errors import InputError
from drivers.core.terminal import visible
from drivers.core.text import counted, did_you_mean

Schema = TypeVar("Schema", bound=BaseModel)
Refusal = TypeVar("Refusal", bound=InputError)

_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = _SHORT.maxlong = 60
# Without this, the text of a nested alias ("billion laughs") would fill the memory.
_SHORT.maxlevel = 3

MOST_NODES = 1_000_000
"""Values of a file, its aliases written out."""
LONGEST_NUMBER = 100
"""Characters of a number; one of 400,000 in base 60 takes YAML seconds to read."""


class _UniqueKeys(SafeConstructor):
    """safe_load without control characters and keys given twice; it names the line of what YAML cannot construct."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """The mapping of a node; a yaml.MarkedYAMLError where a key stands twice."""
        seen: set[str] = set()
        for key_node, _ in node.value:
            key = str(key_node.value)
            if key in seen:
                raise yaml.MarkedYAMLError(problem=f"key '{key}' appears twice", problem_mark=key_node.start_mark)
            seen.add(key)
        return super().construct_mapping(node, deep=deep)

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        """The value of a node; a yaml.MarkedYAMLError where YAML's own constructor breaks, or would take long."""
        number = node.tag in ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")
        if number and len(node.value) > LONGEST_NUMBER:
            raise yaml.MarkedYAMLError(
                problem=f"cannot read the number {describe(node.value)} of {len(node.value)} characters",
                problem_mark=node.start_mark,
            )
        if isinstance(node, yaml.ScalarNode) and visible(node.value) != node.value:
            raise yaml.MarkedYAMLError(
                problem=f"{describe(node.value)} holds a control character", problem_mark=node.start_mark
            )
        try:
            return super().construct_object(node, deep=deep)
        # PyYAML lets these through for scalars such as 2026-99-99 or !!int "".
        except (ValueError, LookupError, AttributeError, TypeError, OverflowError) as error:
            raise yaml.MarkedYAMLError(
                problem=f"cannot read the value {describe(node.value)}", problem_mark=node.start_mark
            ) from error


class _Loader(_UniqueKeys, yaml.SafeLoader):
    """PyYAML's own parser."""


if yaml.__with_libyaml__:
    from yaml.cyaml import CParser  # type: ignore[attr-defined]

    class _CompiledLoader(Composer, CParser, _UniqueKeys, Resolver):
        """libyaml's parser, in a fifth of the time; nodes are put together here, where deep nesting ends no process."""

        def __init__(self, stream: str) -> None:
            CParser.__init__(self, stream)
            Composer.__init__(self)
            _UniqueKeys.__init__(self)
            Resolver.__init__(self)


def load_yaml(text: str) -> Any:
    """The content of a YAML text.

    Raises:
        yaml.YAMLError: it is not YAML, a key stands twice, or its aliases stand for more than `MOST_NODES` values.
        RecursionError: it is nested too deeply.
    """
    # Tabs, and byte order marks within a text, are what the two parsers read differently; libyaml takes ">#", too. What
    # libyaml refuses PyYAML's parser refuses in its own words, the same on each computer.
    if yaml.__with_libyaml__ and "\t" not in text and "\ufeff" not in text:
        with suppress(yaml.YAMLError):
            return _loaded(_CompiledLoader, text)
    return _loaded(_Loader, text)


def _loaded(loader_class: type[Any], text: str) -> Any:
    loader = loader_class(text)
    try:
        node = loader.get_single_node()
        if node is None:
            return None
        _expanded_size(node, {})
        return loader.construct_document(node)
    finally:
        loader.dispose()


def _expanded_size(node: yaml.Node, sizes: dict[int, int]) -> int:
    """Number of values that a node stands for where its aliases and merge keys (`<<`) are written out."""
    size = sizes.get(id(node))
    if size is None:
        sizes[id(node)] = 1  # of an alias within its own value, which is not written out
        children = (
            [member for pair in node.value for member in pair] if isinstance(node, yaml.MappingNode) else node.value
        )
        size = 1
        if not isinstance(node, yaml.ScalarNode):
            size += sum(_expanded_size(child, sizes) for child in children)
        sizes[id(node)] = size
    if size > MOST_NODES:
        raise yaml.MarkedYAMLError(
            problem=f"aliases and merge keys stand for more than {MOST_NODES} values", problem_mark=node.start_mark
        )
    return size


class SeveralProblems(ValueError):  # noqa: N818  # what a validator of a section raises to tell all that it found
    """Several things that are wrong with one section."""

    def __init__(self, messages: Iterable[str]) -> None:
        self.messages = tuple(messages)
        super().__init__("; ".join(self.messages))


@dataclass(frozen=True)
class YamlProblem:
    """One thing that is wrong with a file."""

    key_path: str  # as in `joints[0].velocity`; empty for the file as a whole
    message: str  # what was wrong
    hint: str  # what to do; empty when there is nothing to say


def read_mapping(text: str, *, kind: str, where: str, refusal: type[InputError], hint: str = "") -> dict[Any, Any]:
    """The keys of a file's text, not yet validated.

    Args:
        text: the YAML.
        kind: of the file, in words with their article (`a robot file`).
        where: what an error message calls it.
        refusal: what is raised.
        hint: what to do where it is no mapping at all.

    Raises:
        InputError: `refusal`, where it is not YAML (with line and column), or not a mapping.
    """
    try:
        content = load_yaml(text)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f"{where}, line {mark.line + 1}, column {mark.column + 1}" if mark is not None else where
        raise refusal(f"not valid YAML: {getattr(error, 'problem', None) or error}", where=place) from error
    except RecursionError as error:
        raise refusal(f"nested too deeply to be {kind}", where=where) from error
    if not isinstance(content, dict):
        raise refusal(f"{kind} is a mapping of keys, but this is {describe(content)}", where=where, hint=hint)
    return content


def validated(content: Mapping[Any, Any], schema: type[Schema], *, where: str, refusal: type[InputError]) -> Schema:
    """A file's keys as its schema has them.

    Raises:
        InputError: `refusal`, with the path of the key that is wrong first, what was found and what is allowed.
    """
    try:
        return schema.model_validate(content)
    except ValidationError as error:
        raise first_of(schema_problems(error, schema), where=where, refusal=refusal) from error


def first_of(problems: Sequence[YamlProblem], *, where: str, refusal: type[Refusal]) -> Refusal:
    """The error about the first of several problems; its hint counts the others."""
    first = problems[0]
    more = counted(len(problems) - 1, "more problem(s) in this file") if len(problems) > 1 else ""
    return refusal(
        first.message,
        where=f"{where}: {first.key_path}" if first.key_path else where,
        hint="; ".join(part for part in (first.hint, more) if part),
    )


def schema_problems(error: ValidationError, root: type[BaseModel]) -> tuple[YamlProblem, ...]:
    """Everything that a validation found, in the words of the file whose top level is `root`.

    Unknown keys go before the rest: one is mostly the misspelling of a key that is then missing.
    """
    problems = sorted(error.errors(include_url=False), key=lambda problem: problem["type"] != "extra_forbidden")
    # pydantic calls a list too short when its entries are wrong.
    within = {problem["loc"][:depth] for problem in problems for depth in range(len(problem["loc"]))}
    kept = [problem for problem in problems if not (problem["type"] == "too_short" and problem["loc"] in within)]
    return tuple(line for problem in kept for line in _described(problem, root))


def _described(problem: ErrorDetails, root: type[BaseModel]) -> list[YamlProblem]:
    location = tuple(step for step in problem["loc"] if not str(step).startswith("function-"))
    kind, place = problem["type"], key_path(location)
    if kind == "extra_forbidden":
        allowed = tuple(fields_of(locate(root, location)[2]))
        message = "unknown key" + (f"; allowed here: {', '.join(allowed)}" if allowed else "")
        return [YamlProblem(place, message, did_you_mean(str(location[-1]), allowed))]
    if kind == "value_error":
        error = problem["ctx"]["error"]
        messages = error.messages if isinstance(error, SeveralProblems) else (str(error),)
        return [YamlProblem(place, message, "") for message in messages]
    if kind == "missing":
        message = "this entry of the list is missing" if isinstance(location[-1], int) else "this key is missing"
    else:
        message = f"found {describe(problem['input'])}, but {in_words_of_files(problem['msg']).removeprefix('Input ')}"
        message = message.replace("but should", "but it should").replace("but Keys", "but keys")
    return [YamlProblem(place, message, meaning(root, location))]


def in_words_of_files(message: str) -> str:
    """What pydantic says, without the names of Python's classes."""
    message = re.sub(r"a (valid )?dictionary( or (an )?instance of \w+)?", "a mapping of keys", message)
    return re.sub(r"a valid (tuple|list)", "a list", message)


def key_path(location: Sequence[int | str]) -> str:
    """`joints[0].velocity` of ("joints", 0, "velocity")."""
    return "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in location).lstrip(".")


def meaning(root: type[BaseModel], location: Sequence[int | str]) -> str:
    """What the key at `location` means and its unit, from the description of its field; empty where there is none."""
    field = locate(root, location)[1]
    return (field.description or "") if field is not None else ""


def locate(schema: type[BaseModel], location: Sequence[int | str]) -> tuple[str, FieldInfo | None, type[BaseModel]]:
    """Key path of a pydantic location, its field (None of an unknown key) and the section that it stands in."""
    path, field, section = "", None, schema
    annotation: Any = schema
    for step in location:
        if isinstance(annotation, type) and issubclass(annotation, BaseModel):
            section, field = annotation, fields_of(annotation).get(str(step))
            path += f".{step}"
            if field is None:
                break
            annotation = plain_type(field.annotation)
        elif get_origin(annotation) in (tuple, dict):
            path += f"[{step}]" if isinstance(step, int) and get_origin(annotation) is tuple else f".{step}"
            arguments = [get_arg for get_arg in get_args(annotation) if get_arg is not Ellipsis]
            annotation = plain_type(arguments[-1])
        elif step in (choices := {choice.__name__: choice for choice in _sections(annotation)}):
            annotation = choices[str(step)]  # a tagged union: the tag is the section's name
        else:  # a member of a union, or pydantic's name of a validator
            break
    return path.lstrip("."), field, section


def fields_of(section: type[BaseModel]) -> dict[str, FieldInfo]:
    """Key of the file → field."""
    return {field.alias or name: field for name, field in section.model_fields.items()}


def plain_type(annotation: Any) -> Any:
    """An annotation without None and constraints; of a union its first member, unless there are several sections."""
    if get_origin(annotation) is Annotated:
        return plain_type(get_args(annotation)[0])
    if get_origin(annotation) in (Union, types.UnionType):
        return annotation if len(_sections(annotation)) > 1 else plain_type(_members(annotation)[0])
    return annotation


def _members(annotation: Any) -> list[Any]:
    return [get_arg for get_arg in get_args(annotation) if get_arg is not type(None)]


def _sections(annotation: Any) -> list[type[BaseModel]]:
    """The sections among the members of a union."""
    members = [plain_type(member) for member in _members(annotation)]
    return [member for member in members if isinstance(member, type) and issubclass(member, BaseModel)]


def describe(value: Any) -> str:
    """A value of the file in at most some 60 characters."""
    if value is None:
        return "nothing"
    text = _SHORT.repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
