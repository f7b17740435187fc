"""Connection settings: strict pydantic models of a connection's keys in a robot file, all errors at once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Literal, Protocol, TypeVar, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Strict, StringConstraints, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails, PydanticCustomError

from drivers.core.errors import UsageError
from drivers.core.text import did_you_mean
from drivers.core.validation import describe, fields_of, locate, plain_type

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

    model_config = ConfigDict(defer_build=True, extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


Settings = TypeVar("Settings", bound=ConnectionSettings)


def refused(message: str, hint: str = "") -> PydanticCustomError:
    """What a validator raises about a value that has the right type; without `hint`, the field says what is allowed."""
    return PydanticCustomError("refused", "{message}", {"message": message, "hint": hint})


class BusDevice(Protocol):
    """The keys of a device that has an id on its bus."""

    @property
    def id(self) -> int: ...  # noqa: D102


def require_motor_per_joint(motors: Mapping[str, BusDevice], joints: Sequence[str], device: str) -> None:
    """Refuse a mapping of joint → keys of its motor that leaves a joint out, or has others or an id twice."""
    if strange := [name for name in motors if name not in joints]:
        raise refused(f"{strange[0]!r} is not a joint", f"joints: {', '.join(joints)}")
    if missing := [name for name in joints if name not in motors]:
        raise refused(f"no motor for {', '.join(missing)}")
    used: dict[int, str] = {}
    for name, motor in motors.items():
        if motor.id in used:
            raise refused(f"{used[motor.id]} and {name} have the same id {motor.id}", f"one id a {device}")
        used[motor.id] = name


def read_settings(
    schema: type[Settings], keys: Mapping[str, object], driver: str, context: Mapping[str, object] | None = None
) -> Settings:
    """The keys of a connection as its driver's schema has them.

    `context` is what the validators need beside the keys, such as the joints.

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
        path, field, section = locate(schema, problem["loc"])
        by_path.setdefault(path, _words(problem, field, section))
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


def _words(problem: ErrorDetails, field: FieldInfo | None, section: type[BaseModel]) -> tuple[str, str, str]:
    """Return what stands before and after the key's name, and the hint."""
    kind, context = problem["type"], problem.get("ctx", {})
    if kind in {"extra_forbidden", "invalid_key"}:
        keys = list(fields_of(section))
        guess = did_you_mean(str(problem["loc"][-1]), keys)
        return "unknown key ", "", f"allowed: {', '.join(keys)}{f'; {guess}' if guess else ''}"
    words = "" if field is None else _allowed(field)
    allowed = f"allowed: {words}" if words else ""
    if kind == "refused":
        return "key ", f": {context['message']}", context["hint"] or allowed
    missing = kind == "missing" or problem["input"] is None
    return "key ", " is missing" if missing else f" is {describe(problem['input'])}", allowed


def _allowed(field: FieldInfo) -> str:
    """Return what a field may be, in words: its type, its limits and its description."""
    plain = plain_type(field.annotation)
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
