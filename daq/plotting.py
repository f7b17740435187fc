"""Figures for users of Python, of plotly or of matplotlib: drawn from traces and a layout as plotly has them."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Literal, cast

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError

Backend = Literal["plotly", "matplotlib"]

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7C828A", "#8C564B", "#6A5ACD", "#66A61E")
"""Colours of lines: the palette of Okabe and Ito, distinguishable by colour-blind readers, and three more."""

_DASHES = {"solid": "-", "dash": "--", "dot": ":"}
_STYLES = [{"color": colour, "dash": dash} for dash, colour in product(_DASHES, COLOURS)]
"""Colours once with each dash, so that 30 lines differ."""

_MARKERS = {"diamond": "D", "square": "s", "triangle-down": "v", "triangle-up": "^", "x-thin": "x", "cross": "+"}
_ROW, _GAP, _TOP, _BOTTOM, _WIDTH = 170, 50, 60, 60, 1000
"""Heights of a panel, between two, above and below all; width of a figure that matplotlib draws [px]."""


@dataclass(frozen=True)
class LinePanel:
    """Lines over one abscissa: `lines` by name, each (M,) over `x` (M,), above them `heading`."""

    heading: str
    x: FloatArray
    lines: Mapping[str, FloatArray]
    x_title: str
    y_title: str


def line_figure(panels: Sequence[LinePanel], columns: int, backend: Backend, *, linked: bool = False) -> Any:
    """Panels of lines in rows; a line of one name has one colour in all of them.

    Args:
        panels: row by row.
        columns: panels of a row.
        backend: what draws.
        linked: whether all panels show the same part of their common abscissa.

    Raises:
        UsageError: the backend does not exist or is not installed.
    """
    names = list(dict.fromkeys(name for panel in panels for name in panel.lines))
    styles = {name: _STYLES[place % len(_STYLES)] for place, name in enumerate(names)}
    rows = -(-len(panels) // columns)
    inner = rows * _ROW + (rows - 1) * _GAP
    data, notes, shown = [], [], set()
    layout: dict[str, Any] = {
        "height": inner + _TOP + _BOTTOM,
        "showlegend": len(names) > 1,
        "template": "plotly_white",
    }
    for place, panel in enumerate(panels):
        row, column = divmod(place, columns)
        ref = "" if place == 0 else str(place + 1)
        left, top = column / columns, 1.0 - row * (_ROW + _GAP) / inner
        right, low = left + (1.0 - 0.08 * (columns > 1)) / columns, max(0.0, top - _ROW / inner)
        last = place + columns >= len(panels)
        layout[f"xaxis{ref}"] = {
            "domain": [left, min(1.0, right)],
            "anchor": f"y{ref}",
            "title": {"text": panel.x_title if last or not linked else ""},
            **({"matches": "x"} if linked and ref else {}),
        }
        layout[f"yaxis{ref}"] = {"domain": [low, top], "anchor": f"x{ref}", "title": {"text": panel.y_title}}
        notes.append(
            {"text": f"<b>{panel.heading}</b>", "x": left, "y": top, "xref": "paper", "yref": "paper",
             "xanchor": "left", "yanchor": "bottom", "showarrow": False}
        )  # fmt: skip
        for name, y in panel.lines.items():
            data.append(
                {"type": "scatter", "mode": "lines", "name": name, "legendgroup": name, "showlegend": name not in shown,
                 "x": panel.x, "y": y, "xaxis": f"x{ref}", "yaxis": f"y{ref}", "line": {**styles[name], "width": 1.4}}
            )  # fmt: skip
            shown.add(name)
    layout |= {"annotations": notes, "margin": {"l": 70, "r": 20, "t": _TOP, "b": _BOTTOM}, "hovermode": "closest"}
    return drawn(data, layout, backend)


def drawn(data: Sequence[Mapping[str, Any]], layout: Mapping[str, Any], backend: Backend) -> Any:
    """The figure: a `plotly.graph_objects.Figure`, or a `matplotlib.figure.Figure` of the same lines and markers.

    Raises:
        UsageError: the backend does not exist or is not installed.
    """
    data = [_plain(trace) for trace in data]
    if backend == "plotly":
        from plotly.graph_objects import Figure

        return Figure(data, {"template": "plotly_white", **layout})
    if backend != "matplotlib":
        raise UsageError(f"there is no backend '{backend}'", hint='backend="plotly" or backend="matplotlib"')
    try:
        import matplotlib.pyplot as plt
    except ImportError as error:
        raise UsageError("this figure needs matplotlib", hint="pip install matplotlib") from error
    return _matplotlib(plt, data, layout)


def _plain(value: Any) -> Any:
    """A part of a figure with its packed numbers as arrays, which every version of plotly reads."""
    if isinstance(value, Mapping):
        if "bdata" in value:
            return np.frombuffer(base64.b64decode(value["bdata"]), dtype=f"<{value['dtype']}").astype(np.float64)
        return {key: _plain(entry) for key, entry in value.items()}
    return value


def _matplotlib(plt: Any, data: Sequence[Mapping[str, Any]], layout: Mapping[str, Any]) -> Any:
    height, margin = layout["height"], layout["margin"]
    figure = plt.figure(figsize=(_WIDTH / 100, height / 100))
    left, bottom = margin["l"] / _WIDTH, margin["b"] / height
    width, tall = 1 - left - margin["r"] / _WIDTH, 1 - bottom - margin["t"] / height
    places: dict[tuple[str, str], Any] = {}
    labelled: dict[str, Any] = {}
    for trace in data:
        names = trace.get("xaxis", "x"), trace.get("yaxis", "y")
        if names not in places:
            x, y = (layout.get(f"{name[0]}axis{name[1:]}", {}) for name in names)
            (x0, x1), (y0, y1) = x.get("domain", (0, 1)), y.get("domain", (0, 1))
            box = (left + width * x0, bottom + tall * y0, width * (x1 - x0), tall * (y1 - y0))
            places[names] = axes = figure.add_axes(box)
            axes.grid(alpha=0.3)
            axes.set(xlabel=_title(x), ylabel=_title(y))
            for axis, scale in ((x, axes.set_xscale), (y, axes.set_yscale)):
                if axis.get("type") == "log":
                    scale("log")
            if y.get("type") == "category":
                axes.invert_yaxis()
        line = _line(places[names], trace)
        if trace.get("showlegend", True) and trace.get("name"):
            labelled.setdefault(_words(trace["name"]), line)
    for note in layout.get("annotations", ()):
        x, y = left + width * note["x"], bottom + tall * note["y"]
        figure.text(x, y, _words(note["text"]), ha=note.get("xanchor", "left"), va="bottom", fontsize=9)
    if layout.get("showlegend", True) and len(labelled) > 1:
        figure.legend(list(labelled.values()), list(labelled), loc="upper left", ncols=6, fontsize=8, frameon=False)
    return figure


def _line(axes: Any, trace: Mapping[str, Any]) -> Any:
    line, marker = trace.get("line", {}), trace.get("marker", {})
    colour = line.get("color") or (marker.get("color") if isinstance(marker.get("color"), str) else None)
    symbol = str(marker.get("symbol", "circle"))
    markers = "markers" in trace.get("mode", "lines")
    (drawn_line,) = axes.plot(
        trace["x"],
        trace["y"],
        color=colour,
        linestyle=_DASHES.get(line.get("dash", "solid"), "-") if "lines" in trace.get("mode", "lines") else "none",
        linewidth=line.get("width", 1.2),
        marker=_MARKERS.get(symbol.removesuffix("-open"), "o") if markers else "",
        markersize=0.8 * cast(float, marker.get("size", 6)),
        markerfacecolor="none" if symbol.endswith("-open") else colour,
        alpha=marker.get("opacity", 1.0),
    )
    return drawn_line


def _title(axis: Mapping[str, Any]) -> str:
    return _words(axis.get("title", {}).get("text", ""))


def _words(text: str) -> str:
    """A text without plotly's small markup."""
    return re.sub(r"<[^>]*>", "", text).replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&")
