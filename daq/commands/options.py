"""Options that several commands share, and commands that take the fields of a dataclass of options."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import MISSING, Field, fields
from pathlib import Path
from typing import Any, TypeVar

import typer

from daq.commands.completion import COMPLETIONS
from drivers.core.options import Option, declared, flag_of, panel_of

Given = TypeVar("Given")

FORCE = typer.Option(False, "--force", help="Overwrite files that exist.")
JSON = typer.Option(False, "--json", help="One JSON object on standard output, nothing else there.")
ROBOT = typer.Argument(help="Built-in robot or robot file.", autocompletion=COMPLETIONS["robot"])
VERBOSE = typer.Option(False, "--verbose", "-v", help="Everything that was computed, not the outcome alone.")

_TYPES = {"bool": bool, "int": int, "float": float, "Path": Path}
"""Types of values that Typer reads; everything else is text."""


def takes(options: type[Given], **more: dict[str, Any]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """A command whose parameter `options` is a dataclass; its arguments and options stand in the parameter's place.

    Args:
        options: the dataclass.
        more: further settings of Typer by the field's name.
    """
    stated = [(of, told) for of in fields(options) if (told := declared(of)) is not None and told.help]  # type: ignore[arg-type]

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        own = inspect.signature(function, eval_str=True).parameters
        shown: list[inspect.Parameter] = []
        for name, parameter in own.items():
            if name == "options":
                shown += [
                    _parameter(of, told, {"rich_help_panel": panel_of(options, of)} | more.get(of.name, {}))
                    for of, told in stated
                ]
            else:
                shown.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY))

        def command(**values: Any) -> None:
            given = {}
            for of, told in stated:
                value = values.pop(told.argument or of.name)
                if told.read is not None and value is not None:
                    value = told.read(value, flag_of(of))
                if value is not None:
                    given[of.name] = value
            function(options=options(**given), **values)

        command.__doc__ = function.__doc__
        command.__signature__ = inspect.Signature(shown)  # type: ignore[attr-defined]
        command.__annotations__ = {parameter.name: parameter.annotation for parameter in shown}
        return command

    return decorate


def _parameter(of: Field[Any], told: Option, more: dict[str, Any]) -> inspect.Parameter:
    """A field as Typer reads it."""
    plain = str if told.read is not None else _TYPES.get(str(of.type).removesuffix(" | None"), str)
    value_type = told.command_type or plain
    required = of.default is MISSING and of.default_factory is MISSING
    default = ... if required else told.shown if told.read is not None else of.default
    flags = () if told.argument else (flag_of(of),)
    completion = COMPLETIONS.get(told.argument or of.name)
    place = (typer.Argument if told.argument else typer.Option)(
        default, *flags, help=told.help, metavar=told.metavar, autocompletion=completion, **more
    )
    return inspect.Parameter(
        told.argument or of.name, inspect.Parameter.KEYWORD_ONLY, default=place, annotation=value_type
    )
