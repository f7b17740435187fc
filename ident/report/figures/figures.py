"""Figures as plotly.js reads them: plain data and a layout; colours of text and grid come from the page's style."""

from __future__ import annotations

import html
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from markupsafe import Markup

from daq.plotting import COLOURS, Backend, drawn
from ident.friction.table import TERMS
from ident.report.figures.traces import points_trace
from ident.result.schema import BaseParameterResult

MEASURED = "#0072B2"
PREDICTED = "#D55E00"
RESIDUAL = "#7C828A"
ACCENT = "#0072B2"
REFERENCE = "#D55E00"
KIND_STYLES: dict[str, tuple[str, str, str]] = {
    "inertial": ("inertial", "#0072B2", "circle"),
    "motor_inertia": ("motor inertia", "#CC79A7", "square"),
    "coupling": ("coupled joint", "#E69F00", "triangle-down"),
    **{term.kind: (term.words, term.colour, term.marker) for term in TERMS},
}
"""Label, colour and marker of each kind: palette of Okabe and Ito, distinguishable by colour-blind readers."""

SERIES_COLOURS = COLOURS
"""Lines of one panel, of the same palette."""

LEFT, RIGHT, TOP, BOTTOM = 64, 16, 54, 48
NARROW_LEFT, NARROW_RIGHT, NARROW_TOP = 50, 12, 84
"""Margins [px]. On a phone the legend stands below the tool bar, not beside it."""

LOG_AXIS: dict[str, Any] = {"type": "log", "tickformat": "~g", "nticks": 3}
"""A logarithmic axis whose ticks are numbers: 0.01, 0.1, 1. With more of them, 0.8, 0.9 and 1 lie on each other."""


@dataclass(frozen=True)
class Figure:
    """One figure of the page."""

    anchor: str  # its id within the page
    height: int  # [px]
    # data, layout: what Plotly.newPlot takes
    data: Sequence[Mapping[str, Any]]
    layout: Mapping[str, Any]
    caption: str  # what is shown, and what was left out
    # keys of the layout that are others on a phone's width, its height included; see `narrow_layout`
    narrow: Mapping[str, Any] = field(default_factory=dict)

    def drawn(self, backend: Backend) -> Any:
        """The figure for a user of Python: plotly's or matplotlib's.

        Raises:
            UsageError: the backend does not exist or is not installed.
        """
        return drawn(self.data, self.layout, backend)

    @property
    def narrow_height(self) -> int:
        """Height on a phone's width [px]."""
        return int(self._narrow["height"])

    @property
    def _narrow(self) -> dict[str, Any]:
        return {**narrow_layout(self.height), **self.narrow}

    @property
    def json(self) -> Markup:
        """The figure as strict JSON that may stand within a script element."""
        content = {"data": list(self.data), "layout": self.layout, "narrow": self._narrow}
        text = json.dumps(content, allow_nan=False, separators=(",", ":"))
        for character in "<>&":
            text = text.replace(character, f"\\u{ord(character):04x}")
        return Markup(text)


def shortened(text: str, length: int) -> str:
    """A name cut to at most `length` characters."""
    return text if len(text) <= length else f"{text[: length - 1]}…"


def plain(text: str) -> str:
    """A name as plotly.js shall show it: its own small markup language does not apply."""
    return html.escape(text, quote=False)


def bold(name: str, length: int = 24) -> str:
    """A name as the heading of a panel, cut to at most `length` characters."""
    return f"<b>{plain(shortened(name, length))}</b>"


def titled(text: str) -> dict[str, Any]:
    """An axis with a title."""
    return {"title": {"text": text}}


def base_layout(height: int, **more: Any) -> dict[str, Any]:
    """Layout that all figures share."""
    return {
        "height": height,
        "margin": {"l": LEFT, "r": RIGHT, "t": TOP, "b": BOTTOM},
        "legend": {"orientation": "h", "x": 0, "xanchor": "left", "y": 1, "yanchor": "top", "yref": "container"},
        "hovermode": "closest",
        "dragmode": "zoom",
        **more,
    }


def narrow_layout(height: int) -> dict[str, Any]:
    """Layout keys that all figures share on a phone; a finger scrolls the page until the tool bar is asked for zoom."""
    return {
        "height": height,
        "margin": {"l": NARROW_LEFT, "r": NARROW_RIGHT, "t": NARROW_TOP, "b": BOTTOM},
        "legend": {
            "orientation": "h", "x": 0, "xanchor": "left", "y": 1 - 28 / height, "yanchor": "top", "yref": "container",
        },
        "dragmode": False,
    }  # fmt: skip


def axis_name(letter: str, index: int) -> str:
    """Key of an axis in the layout, numbered from 1: `xaxis`, `xaxis2` and so on."""
    return f"{letter}axis{index if index > 1 else ''}"


def axis_ref(letter: str, index: int) -> str:
    """Return how a trace names an axis, numbered from 1: `x`, `x2` and so on."""
    return f"{letter}{index if index > 1 else ''}"


def note(text: str, x: float, y: float, **more: Any) -> dict[str, Any]:
    """A line of text, placed relative to the plot's width and height; `text` may hold plotly's markup."""
    return {
        "text": text, "x": x, "y": y, "xref": "paper", "yref": "paper", "xanchor": "left", "yanchor": "bottom",
        "showarrow": False, "align": "left", **more,
    }  # fmt: skip


def vertical_line(x: float, **line: Any) -> dict[str, Any]:
    """A line over the whole height at `x` of the first axis."""
    return {"type": "line", "x0": x, "x1": x, "y0": 0, "y1": 1, "xref": "x", "yref": "paper", "line": line}


def kind_markers(
    entries: Sequence[tuple[BaseParameterResult, float]], hover: str, error: Mapping[str, Any] | None = None
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """One row per base parameter, its value as a marker in the style of its kind: traces, and the axis of the names."""
    data: list[dict[str, Any]] = []
    names: list[str] = []
    for kind, (words, colour, symbol) in KIND_STYLES.items():
        entries_of_kind = [(plain(parameter.name), value) for parameter, value in entries if parameter.kind == kind]
        if entries_of_kind:
            names += [name for name, _ in entries_of_kind]
            data.append(
                points_trace(
                    [value for _, value in entries_of_kind],
                    [name for name, _ in entries_of_kind],
                    {"color": colour, "symbol": symbol, "size": 8},
                    hover,
                    name=words,
                )
            )
            if error is not None:
                data[-1]["error_x"] = {**error, "color": colour}
    return data, category_axis(names)


def category_axis(names: Sequence[str]) -> dict[str, Any]:
    """A vertical axis with a row per name, the first one at the top."""
    return {
        "type": "category", "categoryorder": "array", "categoryarray": names, "range": [len(names) - 0.4, -0.6],
        "dtick": 1, "tickfont": {"size": 10}, "automargin": True,
    }  # fmt: skip
