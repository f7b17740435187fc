"""Connection settings: strict pydantic models of a connection's keys in a robot file, all errors at once."""

from __future__ import annotations

import types
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Strict, StringConstraints, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails, PydanticCustomError

from drivers.closest import did_you_mean
from drivers.errors import UsageError
from drivers.yaml_file import describe

WITH = "with"
"""Key of a connection that belongs to the session: names of others that are recorded beside it."""
MOST_PROBLEMS = 8
"""Problems in one message."""

Text = Annotated[str, StringConstraints(strip_whitespace=True, min_length=1)]
"""Not blank."""
Element = TypeVar("Element")
Entries = Annotated[tuple[Element, ...], Strict(strict=False)]
"""A list of the file; its elements are as strict as everything else."""


class ConnectionSettings(BaseModel):
    """A mapping of the file: no unknown key, no boolean or text for a number, no number that is not finite.

    A field's `description` completes what a refusal says of the allowed values: unit in brackets first.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


Settings = TypeVar("Settings", bound=ConnectionSettings)


def refused(message: str, hint: str = "") -> PydanticCustomError:
    """What a validator raises about a value that has the right type; without `hint`, the field says what is allowed."""
    return PydanticCustomError("refused", "{message}", {"message": message, "hint": hint})


def read_settings(
    schema: type[Settings], keys: Mapping[str, object], driver: str, context: Mapping[str, object] | None = None
) -> Settings:
    """The keys of a connection as its driver's schema has them.

    Args:
        schema: of the keys.
        keys: as the robot file has them, without `driver`.
        driver: what a message calls the connection's kind.
        context: what the validators need beside the keys, such as the joints.

    Raises:
        UsageError: names every key that is wrong, what was found and what is allowed.
    """
    given = {key: value for key, value in keys.items() if key != WITH and value is not None}  # `key:` says nothing
    try:
        return schema.model_validate(given, context=dict(context or {}))
    except ValidationError as error:
        raise refusal(error.errors(include_url=False), schema, f"the {driver} connection") from error


def refusal(problems: Iterable[ErrorDetails], schema: type[BaseModel], connection: str) -> UsageError:
    """One error about all that is wrong with a connection's keys."""
    by_path: dict[str, tuple[str, str, str]] = {}
    for problem in problems:
        path, field, section = _locate(schema, problem["loc"])
        by_path.setdefault(path, _words(problem, path, field, section))
    if len(by_path) == 1:
        ((path, (before, after, hint)),) = by_path.items()
        name = f"{before}'{path}' of {connection}" if path else connection
        return UsageError(f"{name}{after}", hint=hint)
    texts = [
        f"{before.removeprefix('key ')}'{path}'{after}" + (f" ({hint})" if hint else "")
        for path, (before, after, hint) in by_path.items()
    ]
    more = f"; and {len(texts) - MOST_PROBLEMS} more" if len(texts) > MOST_PROBLEMS else ""
    return UsageError(f"{len(texts)} keys of {connection} are wrong: {'; '.join(texts[:MOST_PROBLEMS])}{more}")


def _words(problem: ErrorDetails, path: str, field: FieldInfo | None, section: type[BaseModel]) -> tuple[str, str, str]:
    """What stands before and after the key's name, and the hint."""
    kind, context = problem["type"], problem.get("ctx", {})
    if kind in {"extra_forbidden", "invalid_key"}:
        known = list(_fields(section))
        guess = did_you_mean(str(problem["loc"][-1]), known)
        return "unknown key ", "", f"allowed: {', '.join(known)}{f'; {guess}' if guess else ''}"
    words = "" if field is None else _allowed(field)
    allowed = f"allowed: {words}" if words else ""
    if kind == "refused":
        return "key ", f": {context['message']}", context["hint"] or allowed
    missing = kind == "missing" or problem["input"] is None
    return "key ", " is missing" if missing else f" is {describe(problem['input'])}", allowed


def _allowed(field: FieldInfo) -> str:
    """What a field may be, in words: its type, its limits and its description."""
    plain = _plain(field.annotation)
    limits: dict[str, float] = {}
    for constraint in field.metadata:
        limits |= {name: getattr(constraint, name) for name in ("ge", "le") if hasattr(constraint, name)}
    kind = {int: "an integer", float: "a number", bool: "true or false"}.get(plain, "")
    if get_origin(plain) is Literal:
        kind = " or ".join(map(str, get_args(plain)))
    if "ge" in limits and "le" in limits:
        kind += f" from {limits['ge']:.10g} to {limits['le']:.10g}"
    description = field.description or ""
    return f"{kind}{' ' if description.startswith('[') or not kind else ', '}{description}".strip(" ,")


def _locate(schema: type[BaseModel], location: tuple[int | str, ...]) -> tuple[str, FieldInfo | None, type[BaseModel]]:
    """Key path of a pydantic location, its field (None of an unknown key) and the section that it stands in."""
    path, field, section = "", None, schema
    annotation: Any = schema
    for part in location:
        if isinstance(annotation, type) and issubclass(annotation, BaseModel):
            section, field = annotation, _fields(annotation).get(str(part))
            path += f".{part}"
            if field is None:
                break
            annotation = _plain(field.annotation)
        elif get_origin(annotation) in (tuple, dict):
            path += f"[{part}]" if isinstance(part, int) and get_origin(annotation) is tuple else f".{part}"
            arguments = [one for one in get_args(annotation) if one is not Ellipsis]
            annotation = _plain(arguments[-1])
        elif part in (choices := {one.__name__: one for one in _sections(annotation)}):
            annotation = choices[str(part)]  # a tagged union: the tag is the section's name
        else:  # a member of a union, or pydantic's name of a validator
            break
    return path.lstrip("."), field, section


def _fields(section: type[BaseModel]) -> dict[str, FieldInfo]:
    """Key of the file → field."""
    return {field.alias or name: field for name, field in section.model_fields.items()}


def _plain(annotation: Any) -> Any:
    """An annotation without None and constraints; of a union its first member, unless there are several sections."""
    if get_origin(annotation) is Annotated:
        return _plain(get_args(annotation)[0])
    if get_origin(annotation) in (Union, types.UnionType):
        return annotation if len(_sections(annotation)) > 1 else _plain(_members(annotation)[0])
    return annotation


def _members(annotation: Any) -> list[Any]:
    return [one for one in get_args(annotation) if one is not type(None)]


def _sections(annotation: Any) -> list[type[BaseModel]]:
    """The sections among the members of a union."""
    members = [_plain(one) for one in _members(annotation)]
    return [one for one in members if isinstance(one, type) and issubclass(one, BaseModel)]
