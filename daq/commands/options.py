"""Options that several commands share, and commands that take the fields of a dataclass of options."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import MISSING, Field, fields
from pathlib import Path
from typing import Any, TypeVar

import typer

from drivers.core.options import Option, argument, declared, flag_of, option, panel_of

BUILTIN_FOLDER = Path(__file__).parents[1] / "robot" / "builtin"


def _files(*suffixes: str) -> Callable[[str], list[str]]:
    """Completes paths of files with a suffix, and of folders on the way there."""

    def complete(incomplete: str) -> list[str]:
        head = incomplete[: incomplete.rfind("/") + 1]
        matches = []
        with suppress(OSError):
            for entry in os.scandir(head or "."):
                path, folder = head + entry.name, entry.is_dir()
                wanted = (folder or entry.name.endswith(suffixes)) and not entry.name.startswith((".", "-"))
                if wanted and path.startswith(incomplete):
                    matches.append(f"{path}/" if folder else path)
        return sorted(matches)

    return complete


def _robots(incomplete: str) -> list[str]:
    """Completes built-in names, then robot files."""
    names = sorted(path.stem for path in BUILTIN_FOLDER.glob("*.yaml"))
    return [name for name in names if name.startswith(incomplete)] + _files(".yaml", ".urdf")(incomplete)


COMPLETIONS: dict[str, Callable[[str], list[str]]] = {
    "robot": _robots,
    **dict.fromkeys(("recordings", "recording", "free", "loaded", "validation"), _files(".h5")),
    **dict.fromkeys(("trajectory", "earlier"), _files(".yaml")),
    **dict.fromkeys(("model", "models", "result", "prior"), _files("result.json")),
}
"""Completions by the name of an argument or option of a command."""


Given = TypeVar("Given")

FORCE = typer.Option(False, "--force", help="Overwrite files that exist.")
JSON = typer.Option(False, "--json", help="Print one JSON object on standard output and nothing else.")
ROBOT = typer.Argument(help="Built-in robot or robot file.", autocompletion=COMPLETIONS["robot"])
REALTIME = typer.Option(False, "--realtime", help="Ask for real-time priority (Linux; needs permission).")
NO_UI: bool = typer.Option(False, "--no-ui", help="No live status on stderr.")
VERBOSE = typer.Option(False, "--verbose", "-v", help="Print everything that was computed, not only the outcome.")

ROBOT_ARGUMENT = argument("robot", "Built-in robot or robot file.")
"""Metadata of a field of options."""

_TYPES = {"bool": bool, "int": int, "float": float, "Path": Path}
"""Types of values that Typer reads; everything else is text."""


def out_option(written: str, default: Any = None) -> Path:
    """`-o`, `--out` of a command. `written`: help text, with the default place; `default=...` makes it required."""
    path: Path = typer.Option(default, "-o", "--out", help=written)
    return path


def folder_option(file: str, default: Path | None = None) -> Path:
    """`-o`, `--out` of a command that writes a file and its report."""
    return out_option(f"Folder for {file} and report.html.", default)


def page_option(written: str = "Page with plots to write (.html).", panel: str | None = None) -> Path:
    """`--page` of a command."""
    path: Path = typer.Option(None, "--page", help=written, rich_help_panel=panel)
    return path


def csv_option(written: str) -> Path:
    """`--csv` of a command."""
    path: Path = typer.Option(None, "--csv", help=written)
    return path


def host_option() -> str | None:
    """A field of options."""
    return option(None, "Address instead of the connection's own.")


def takes(options: type[Given], **more: dict[str, Any]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """A command whose parameter `options` is a dataclass; its arguments and options stand in the parameter's place.

    `more` are further settings of Typer by the field's name.
    """
    entries = [(of, entry) for of in fields(options) if (entry := declared(of)) is not None and entry.help]  # type: ignore[arg-type]

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        own = inspect.signature(function, eval_str=True).parameters
        shown: list[inspect.Parameter] = []
        for name, parameter in own.items():
            if name == "options":
                shown += [
                    _parameter(of, entry, {"rich_help_panel": panel_of(options, of)} | more.get(of.name, {}))
                    for of, entry in entries
                ]
            else:
                shown.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY))

        def command(**values: Any) -> None:
            given = {}
            for of, entry in entries:
                value = values.pop(entry.argument or of.name)
                if entry.read is not None and value is not None:
                    value = entry.read(value, flag_of(of))
                if value is not None:
                    given[of.name] = value
            function(options=options(**given), **values)

        command.__doc__ = function.__doc__
        command.__signature__ = inspect.Signature(shown)  # type: ignore[attr-defined]
        command.__annotations__ = {parameter.name: parameter.annotation for parameter in shown}
        return command

    return decorate


def _parameter(of: Field[Any], entry: Option, more: dict[str, Any]) -> inspect.Parameter:
    """A field as Typer reads it."""
    plain = str if entry.read is not None else _TYPES.get(str(of.type).removesuffix(" | None"), str)
    value_type = entry.command_type or plain
    required = of.default is MISSING and of.default_factory is MISSING
    default = ... if required else entry.shown if entry.read is not None else of.default
    flags = () if entry.argument else tuple(filter(None, (flag_of(of), entry.short)))
    completion = COMPLETIONS.get(entry.argument or of.name)
    place = (typer.Argument if entry.argument else typer.Option)(
        default, *flags, help=entry.help, metavar=entry.metavar, autocompletion=completion, **more
    )
    return inspect.Parameter(
        entry.argument or of.name, inspect.Parameter.KEYWORD_ONLY, default=place, annotation=value_type
    )
