"""Options declared once: a dataclass field holds the name, type, default, range and texts of command line and API.

A dataclass of options derives from `Options`, which checks every value. `@keywords_of(SomeOptions)` gives a function of
Python the dataclass's arguments, which type checkers and editors see; `takes` of `daq/commands/options.py` gives
them to a command.
"""

from __future__ import annotations

import inspect
import math
import numbers
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, Field, dataclass, field, fields
from functools import wraps
from types import MappingProxyType
from typing import Any, ParamSpec, TypeVar, cast

from drivers.core.errors import ArgumentError, DynidError, UsageError
from drivers.core.numerics import numerical_settings
from drivers.core.ranges import Range, check_option
from drivers.core.text import did_you_mean

_Value = TypeVar("_Value")
_Options = TypeVar("_Options")
_Result = TypeVar("_Result")
_Arguments = ParamSpec("_Arguments")

_METADATA = "option"
_WIDTH = 112
"""Characters of a line of a docstring."""


@dataclass(frozen=True)
class Option:
    """What a field declares beside its name, type and default."""

    help: str = ""  # text of the command's `--help`; empty for an argument of the API alone
    meaning: str = ""  # text of the API's docstring, with the unit; the same as `help` where empty
    flag: str = ""  # on the command line; `--name` where empty
    short: str = ""  # the same in one letter, such as `-o`; empty for none
    allowed: Range | None = None  # range of the number, or of each number of a tuple
    one_of: tuple[str, ...] = ()  # allowed texts
    hint: str = ""  # what to do about a value that is refused
    metavar: str | None = None  # what `--help` calls the value
    # turns the text of the command line and the flag into the value; None where Typer does
    read: Callable[[str, str], Any] | None = None
    shown: str | None = None  # default of the command line's text where `read` turns it into the field's default
    # type on the command line where it is not that of the field, such as `Path` or `list[Path]`
    command_type: Any = None
    argument: str = ""  # name of a positional argument of the command; empty for an option
    # of the command's help; its dataclass's `PANEL` where None, the common options first where empty
    panel: str | None = None

    def check(self, flag: str, value: Any) -> None:
        """Refuse a value that is not allowed; None always is.

        Raises:
            UsageError: names the option, its value and what is allowed.
        """
        if self.read is read_names and isinstance(value, str):  # a string is a sequence of letters
            raise UsageError(
                f"'{value}' is a single string; a list of joint names is needed", where=flag, hint=f"['{value}']"
            )
        if self.one_of and value is not None and value not in self.one_of:
            raise UsageError(
                f"{flag} '{value}' does not exist", hint=" or ".join([", ".join(self.one_of[:-1]), self.one_of[-1]])
            )
        for number in value if isinstance(value, tuple) else (value,):
            if isinstance(number, float) and not math.isfinite(number):
                raise UsageError(f"{flag} {number} is not a finite number")
            if self.allowed is not None and number is not None:
                check_option(flag, number, self.allowed, self.hint)


def option(default: _Value, help: str = "", **more: Any) -> _Value:
    """A field with a default; `more` are fields of `Option`."""
    metadata = {_METADATA: Option(help, **more)}
    if isinstance(default, dict):  # each instance has its own
        return cast("_Value", field(default_factory=default.copy, metadata=metadata))
    return field(default=default, metadata=metadata)


def argument(name: str, help: str, **more: Any) -> dict[str, Option]:
    """Metadata of a field without a default, a positional argument called `name` on the command line."""
    return {_METADATA: Option(help, argument=name, **more)}


def required(help: str, **more: Any) -> dict[str, Option]:
    """Metadata of a field without a default, an option of the command line that must be given."""
    return {_METADATA: Option(help, **more)}


def declared(of: Field[Any]) -> Option | None:
    """Return what a field declares; None of a field that is no option."""
    return of.metadata.get(_METADATA)


def panel_of(options: type, of: Field[Any]) -> str | None:
    """The panel of the command's help that a field of a dataclass stands in; None among the common options."""
    stated = declared(of)
    if stated is not None and stated.panel is not None:
        return stated.panel or None
    home = next(base for base in options.__mro__ if of.name in inspect.get_annotations(base))
    return vars(home).get("PANEL")


def flag_of(of: Field[Any]) -> str:
    """A field's flag on the command line, as in `--offset/--no-offset`."""
    stated = declared(of)
    return (stated.flag if stated is not None else "") or f"--{of.name.replace('_', '-')}"


def default_of(of: Field[Any]) -> Any:
    """A field's default; `dataclasses.MISSING` where it has none."""
    return of.default if of.default_factory is MISSING else of.default_factory()


_KINDS: dict[str, tuple[type | tuple[type, ...], str]] = {
    "int": (numbers.Integral, "an integer"),
    "float": (numbers.Real, "a number"),
    "str": (str, "a text"),
    "bool": (bool, "True or False"),
    "Progress": (Callable, "a function of a step's name"),  # type: ignore[dict-item]
    "Sequence[str]": (Iterable, "a list of strings"),
    "Collection[str]": (Iterable, "a list of strings"),
    "tuple[str, ...]": (Iterable, "a list of strings"),
    "Mapping[str, str]": (Mapping, "a dictionary of strings"),
    "tuple[float, float]": (Sequence, "two numbers"),
}
"""What the values of fields of these types are instances of, and in words."""
_SHOWN = 60
"""Characters of a value of another kind that an error shows."""


def check_kind(name: str, type_name: str, value: Any) -> None:
    """Refuse a value of another kind than its field's type.

    Raises:
        UsageError: names the option and what it is.
    """
    plain = "Progress" if type_name.startswith("Callable") else type_name.removesuffix(" | None")
    if plain not in _KINDS or (value is None and plain != type_name):
        return
    kind, words = _KINDS[plain]
    sound = isinstance(value, kind) or (plain == "bool" and type(value).__name__ == "bool_")  # NumPy's
    if plain in ("int", "float"):
        sound = sound and not isinstance(value, bool)
    elif sound and "[str" in plain:
        inside = [*value, *value.values()] if isinstance(value, Mapping) else list(value)
        sound = isinstance(value, str) or all(isinstance(piece, str) for piece in inside)
    elif sound and plain == "tuple[float, float]":
        sound = len(value) == 2 and all(isinstance(piece, numbers.Real) for piece in value)
    if not sound:
        raise UsageError(f"{name} {textwrap.shorten(repr(value), _SHOWN, placeholder=' …')} is not {words}")


class Options:
    """Base of a dataclass of options: its values are checked when it is made."""

    def __post_init__(self) -> None:
        """Check every field by what it declares."""
        for of in fields(cast("Any", self)):
            if (stated := declared(of)) is not None:
                check_kind(flag_of(of).partition("/")[0], str(of.type), getattr(self, of.name))
                stated.check(flag_of(of).partition("/")[0], getattr(self, of.name))


def same_named(options: object, dataclass_type: type[_Options], **others: Any) -> _Options:
    """An instance of a dataclass with the values that `options` has under its fields' names, and with the others."""
    names = [of.name for of in fields(cast("Any", dataclass_type)) if hasattr(options, of.name)]
    return dataclass_type(**{name: getattr(options, name) for name in names} | others)


def keywords_of(
    options: Callable[_Arguments, _Options], elsewhere: Mapping[str, str] = MappingProxyType({})
) -> Callable[[Callable[[_Options], _Result]], Callable[_Arguments, _Result]]:
    """A function of one dataclass of options as a function of the dataclass's arguments, described in its docstring.

    `elsewhere` are arguments that people may expect, and what to call for each.
    """

    def decorate(function: Callable[[_Options], _Result]) -> Callable[_Arguments, _Result]:
        names, signature = {of.name: of for of in fields(cast(Any, options))}, inspect.signature(options)

        @wraps(function)
        def call(*args: _Arguments.args, **keywords: _Arguments.kwargs) -> _Result:
            for name in keywords:
                if name not in names:
                    hint = elsewhere.get(name) or did_you_mean(name, names)
                    raise ArgumentError(f"{function.__name__}() has no argument '{name}'{f': {hint}' if hint else ''}")
            try:
                signature.bind(*args, **keywords)
            except TypeError as error:
                raise ArgumentError(
                    f"{function.__name__}(): {error}", hint=f"help(dynid.{function.__name__})"
                ) from None
            try:
                with numerical_settings():
                    return function(options(*args, **keywords))
            except DynidError as error:
                if not _spoken_in_a_shell:
                    in_python(error, names.values())
                raise

        del call.__wrapped__  # what takes the dataclass is not what users call  # type: ignore[attr-defined]
        annotations = {name: value for name, value in function.__annotations__.items() if name == "return"}
        call.__signature__ = signature.replace(return_annotation=annotations.get("return"))  # type: ignore[attr-defined]
        call.__annotations__ = {
            name: parameter.annotation for name, parameter in signature.parameters.items()
        } | annotations
        call.__doc__ = _described(function.__doc__ or "", options)
        return call

    return decorate


_spoken_in_a_shell = False


@contextmanager
def spoken_in_a_shell() -> Iterator[None]:
    """Let errors name options as the command line does until the context ends."""
    global _spoken_in_a_shell
    before, _spoken_in_a_shell = _spoken_in_a_shell, True
    try:
        yield
    finally:
        _spoken_in_a_shell = before


def in_python(error: DynidError, options: Iterable[Field[Any]]) -> None:
    """Let an error name these options as a caller of Python types them: `rate=HZ` for `--rate HZ` in its hint.

    Options of a command that a text spells out (`dynid excite ROBOT --loaded`) stay as they are.
    """
    by_flag = {flag_of(of).partition("/")[0]: of for of in options}

    def named(found: re.Match[str]) -> str:
        of = by_flag.get(found[1])
        return found[0] if of is None or _of_a_command(found) else of.name + found[0].removeprefix(found[1])

    def typed(found: re.Match[str]) -> str:
        of, value = by_flag.get(found[1]), found[3] or ""
        if of is None or _of_a_command(found):
            return found[0]
        after = f"{found[2] or ''}{value}"
        name, equals, column = value.partition("=")
        if equals and (declared(of) or Option()).read is not None:
            return f'{of.name}={{"{name}": "{column}"}}'
        if of.type == "bool":
            return f"{of.name}=True{after}"
        if not value or value in _NO_VALUES:
            return f"{of.name}={after}"
        if str(of.type).startswith(("Collection", "Sequence", "tuple")):
            return f"{of.name}=[{', '.join(map(_quoted, value.split(',')))}]"
        return f"{of.name}={_quoted(value)}"

    pattern = r"(--[a-z][a-z-]*)(?:( )((?:[^\s,;:()]|,(?=\S))+))?"
    for attribute, spelled in (("message", named), ("where", named), ("hint", typed)):
        text = re.sub(r"--[a-z][^,()]*, in Python ", "", getattr(error, attribute))
        setattr(error, attribute, re.sub(pattern, spelled, text))


def _quoted(value: str) -> str:
    """A value as a caller of Python types it; a number and what a text leaves open as they are."""
    return value if re.fullmatch(r"[\d.e+-]+|[A-Z]+", value) else f'"{value}"'


def _of_a_command(match: re.Match[str]) -> bool:
    """Return whether an option belongs to a command that stands before it."""
    return re.search(r"\bdynid \w+[^,:;()]*$", match.string[: match.start()]) is not None


_NO_VALUES = frozenset(
    {"and", "apply", "are", "as", "asks", "does", "exclude", "for", "gives", "goes", "has", "if", "in", "is", "must"}
    | {"names", "need", "needs", "of", "only", "or", "out", "sets", "take", "takes", "the", "to", "tolerates", "use"}
    | {"was", "widen", "with", "without", "would"}
)
"""Words after an option that are not its value."""


def _described(docstring: str, options: Any) -> str:
    """The docstring with a section `Args` of the fields' meanings before the first other section."""
    if not docstring:  # python -OO
        return ""
    section = re.search(r"\n( +)(?:Returns|Raises|Example):\n", docstring)
    indent, place = ("    ", len(docstring) + 1) if section is None else (section[1], section.start() + 1)
    lines = [f"{indent}Args:"]
    by_name = {of.name: declared(of) or Option() for of in fields(options)}
    for name in inspect.signature(options).parameters:
        text = f"{name}: {by_name[name].meaning or by_name[name].help}"
        first, next_ones = indent + " " * 4, indent + " " * 8
        lines += textwrap.wrap(text, _WIDTH, initial_indent=first, subsequent_indent=next_ones, break_on_hyphens=False)
    return docstring[:place] + "\n".join(lines) + "\n\n" + docstring[place:]


def read_names(text: str, flag: str) -> tuple[str, ...]:
    """Names that commas separate.

    Raises:
        UsageError: there is no name in it.
    """
    names = tuple(name for entry in text.split(",") if (name := entry.strip()))
    if not names:
        raise UsageError(f"{flag} '{text}' contains no name")
    return names


def read_numbers(text: str, flag: str) -> tuple[float, ...]:
    """Numbers that commas separate.

    Raises:
        UsageError: they are not numbers.
    """
    try:
        return tuple(float(value) for value in text.split(","))
    except ValueError:
        raise UsageError(f"'{text}' are not numbers separated by commas", where=flag) from None


def read_delay(text: str, flag: str) -> float | None:
    """Delay [s]; None for `auto`.

    Raises:
        UsageError: neither a number nor `auto`.
    """
    if text == "auto":
        return None
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UsageError(f"{flag} {text} is neither 'auto' nor a number of seconds")
    return value
