"""The text of `--method`: NAME[:OPTION=VALUE]…, such as `energy:window=0.5`."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from functools import cache
from importlib import import_module
from pkgutil import iter_modules
from types import MappingProxyType
from typing import Any

from pydantic import TypeAdapter, ValidationError

from drivers.core.errors import UsageError
from ident.estimators import methods as methods_folder
from ident.estimators.estimator import Equations, Estimator, Setup
from ident.estimators.method import Method

OptionValue = float | int | str | bool | None


@dataclass(frozen=True)
class MethodChoice:
    """A method with its options."""

    name: str  # of the method
    method: Method[Any]  # what it is
    options: Any  # an instance of `method.options`

    @property
    def equations(self) -> Equations:
        """One per joint, or one for the whole arm."""
        return self.method.equations

    @property
    def values(self) -> dict[str, OptionValue]:
        """The options by name, defaults included."""
        return asdict(self.options)

    def estimator(self, setup: Setup) -> Estimator:
        """The estimator for these data.

        Raises:
            DynidError: the options do not suit the data.
        """
        return self.method.estimator(self.options, setup)


@cache
def _modules() -> dict[str, str]:
    """The module of each method by the method's name."""
    modules = sorted(module.name for module in iter_modules(methods_folder.__path__))
    return {name.replace("_", "-"): f"{methods_folder.__name__}.{name}" for name in modules}


@cache
def all_methods() -> MappingProxyType[str, Method[Any]]:
    """Every method by its name: one module each of `ident.estimators.methods`."""
    return MappingProxyType({name: import_module(module).METHOD for name, module in _modules().items()})


@cache
def _aliases() -> dict[str, str]:
    """Papers' names of methods with some of their options → that method, as `--method` takes it."""
    methods = all_methods().items()
    return {alias: f"{name}:{options}" for name, method in methods for alias, options in method.aliases.items()}


@cache
def chosen_method(text: str) -> MethodChoice:
    """The method that a text names.

    Args:
        text: NAME[:OPTION=VALUE]…

    Raises:
        UsageError: no such method or option, or a value that it cannot have; says what there is.
    """
    name, *pairs = text.split(":")
    if name not in _modules() and name in _aliases():
        name, *chosen = _aliases()[name].split(":")
        pairs = chosen + pairs
    if name == "servo":
        raise UsageError(
            "servo identifies from commands and encoders, not from torques",
            where="--method",
            hint="dynid identify --method servo, and in Python dynid.identify_servo",
        )
    if name not in _modules():
        *others, last = _modules()
        raise UsageError(f"no method is called '{name}'", where="--method", hint=f"{', '.join(others)} or {last}")
    method: Method[Any] = import_module(_modules()[name]).METHOD  # the others need not be imported
    names = [field.name for field in fields(method.options)]
    given: dict[str, str] = {}
    for pair in pairs:
        option, sign, value = pair.partition("=")
        if option not in names:
            hint = f"its options: {', '.join(names)}" if names else "it has no options"
            raise UsageError(f"the method {name} has no option '{option}'", where="--method", hint=hint)
        if not sign or option in given:
            wrong = "has no value" if not sign else "is given twice"
            raise UsageError(f"the option '{option}' {wrong}", where="--method", hint=f"{name}:{option}=VALUE")
        given[option] = value
    try:
        options = TypeAdapter(method.options).validate_strings(given)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        option = ".".join(str(step) for step in first["loc"][:1])
        described = describe_method(name)
        hint = next(line.strip() for line in described.splitlines() if line.strip().startswith(f"{option}="))
        message = first["msg"].removeprefix("Value error, ")
        raise UsageError(f"{option}={given[option]}: {message}", where=f"--method {name}", hint=hint) from error
    return MethodChoice(name, method, options)


def describe_method(name: str) -> str:
    """A method's summary and its options, a line each."""
    method = all_methods()[name]
    properties = TypeAdapter(method.options).json_schema().get("properties", {})
    defaults = asdict(method.options())
    lines = [f"{name}: {method.summary}"]
    lines += [f"  {alias} is {name}:{options}" for alias, options in method.aliases.items()]
    for option, schema in properties.items():
        default = defaults[option]
        shown = "" if default is None else f" (default {str(default).lower() if default in (True, False) else default})"
        lines.append(f"  {option}={_values(schema)}  {schema['description']}{shown}")
    return "\n".join(lines)


def describe_methods() -> str:
    """All methods with their options."""
    return "\n".join(describe_method(name) for name in all_methods())


def _values(schema: dict[str, Any]) -> str:
    """Return what an option can be, in words."""
    if "enum" in schema:
        return "|".join(str(value) for value in schema["enum"])
    kinds = {schema.get("type"), *(other.get("type") for other in schema.get("anyOf", ()))}
    if "boolean" in kinds:
        return "true|false"
    if kinds & {"number", "integer"}:
        return "NUMBER"
    return "TEXT"
