"""The help of the commands: commands in groups with whole summaries, options in panels, as wide as the terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

GROUPS = ("Robot", "Record", "Look", "Identify", "Use", "Simulate")
"""Groups of commands in the order of their use; a third party's commands follow under their own."""

NAME_WIDTH = 8
"""Characters of a command's name, so that summaries are aligned across groups."""

OTHERS = "Other commands"

CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 110}
"""Settings of the whole command line: wider lines than these are hard to read."""

_VALUES = {"<float>": "NUMBER", "<int>": "N", "<str>": "TEXT", "<path>": "PATH", "<list[Path]>": "PATH"}
"""What Typer calls the type of a value, and what the help does."""


class PanelCommand(TyperCommand):
    """A command whose help has the common options first, then the others by panel (`rich_help_panel`)."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments and options."""
        _write_parameters(self.get_params(ctx), ctx, formatter)


class GroupedCommands(TyperGroup):
    """Commands whose help lists them by group, each with its whole summary."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the commands by group, then the options."""
        rows: dict[str, list[tuple[str, str]]] = {group: [] for group in GROUPS}
        for name in self.list_commands(ctx):
            command = self.get_command(ctx, name)
            if command is not None and not command.hidden:
                summary = (command.help or "").partition("\n\n")[0].partition("\f")[0]
                group = getattr(command, "rich_help_panel", None)
                rows.setdefault(group or OTHERS, []).append((f"{name:<{NAME_WIDTH}}", " ".join(summary.split())))
        _write_sections(rows, formatter)
        _write_parameters(self.get_params(ctx), ctx, formatter)


class CommandApp(typer.Typer):
    """Commands of one group; they have the help's layout and completion without saying so one by one."""

    def __init__(self, group: str, **settings: Any) -> None:
        super().__init__(**settings)
        self._group = group

    def command(self, name: str | None = None, **settings: Any) -> Callable[[Any], Any]:
        """Register a command as Typer does."""
        layout: dict[str, Any] = {"cls": PanelCommand, "rich_help_panel": self._group}
        return super().command(name, **layout | settings)


def _write_parameters(parameters: Iterable[Any], ctx: Any, formatter: Any) -> None:
    sections: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
    for parameter in parameters:
        record = parameter.get_help_record(ctx)
        if record is None:
            continue
        name, text = record
        if parameter.param_type_name == "argument":
            sections["Arguments"].append((name.partition(" <")[0], text.removesuffix("[required]").rstrip()))
            continue
        for shown, meant in _VALUES.items():
            name = name.replace(shown, meant)
        sections.setdefault(parameter.rich_help_panel or "Options", []).append((name, text))
    _write_sections(sections, formatter)


def _write_sections(sections: dict[str, list[tuple[str, str]]], formatter: Any) -> None:
    for title, rows in sections.items():
        if rows:
            with formatter.section(title):
                formatter.write_dl(rows)
