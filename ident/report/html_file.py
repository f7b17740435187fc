"""Rendering of the page templates into one self-contained HTML file."""

from __future__ import annotations

import gzip
import os
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from importlib.resources import files
from math import isfinite
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from ident.compiled.library import cache_folder
from ident.result.tables import Cell, Column, Table, cell_text, numeric
from ident.views import number_text
from ident.views.number_text import half_interval, number, percentage, with_error

if TYPE_CHECKING:
    from jinja2 import Environment


LONG_TEXT = 20
"""Characters from which a column keeps a readable width on a phone."""


def table_html(table: Table, name: str, muted: Sequence[bool] = (), style: str = "") -> Markup:
    """The table as HTML, sorted by any column and saved to a file of this name; muted rows are in pale print."""
    groups = _groups(table.columns)
    classes = [_class(group[0]) for group in groups]
    head = Markup("").join(_heading(group, own) for group, own in zip(groups, classes, strict=True))
    rows = Markup("").join(
        Markup("<tr{}>{}</tr>\n").format(
            Markup(' class="muted"') if any(muted[row : row + 1]) else "",
            Markup("").join(
                _cell(group, row, own, first=group is groups[0]) for group, own in zip(groups, classes, strict=True)
            ),
        )
        for row in range(len(table))
    )
    note = Markup("<p>{}</p>\n").format(table.note) if table.note else ""
    return Markup(
        '<div class="scroll">\n<table class="{}" data-name="{}">\n<thead><tr>{}</tr></thead>\n<tbody>\n{}</tbody>\n'
        "</table>\n</div>\n{}"
    ).format(f"sortable {style}".strip(), name, head, rows, note)


def _groups(columns: Sequence[Column]) -> list[list[Column]]:
    """Columns, each with its σ or its detail."""
    groups: list[list[Column]] = []
    for column in columns:
        if column.kind in ("std", "detail"):
            groups[-1].append(column)
        else:
            groups.append([column])
    return groups


def _heading(group: Sequence[Column], own: Markup) -> Markup:
    column, *others = group
    label, unit = column.heading.removesuffix(f" [{column.unit}]"), f" [{column.unit}]" if column.unit else ""
    label = label[:1].upper() + label[1:] if label[:1].isascii() else label
    added = "".join(" ± 95 %" if other.kind == "std" else f", {other.heading}" for other in others)
    csv = "|".join([column.heading, *("± 95 %" if other.kind == "std" else other.heading for other in others)])
    return Markup('<th scope="col"{} data-csv="{}">{}</th>').format(own, csv, f"{label}{added}{unit}")


def _cell(group: Sequence[Column], row: int, own: Markup, *, first: bool) -> Markup:
    column, *others = group
    value, beside = column.cells[row], {other.kind: other.cells[row] for other in others}
    detail = beside.get("detail")
    small = Markup("<small>{}</small>").format(detail) if detail not in (None, "", value) else ""
    if first:
        return Markup('<th scope="row" data-sort="{}">{}{}</th>').format(row + 1, cell_text(value), small)
    if "number" not in own:
        return Markup("<td{}>{}{}</td>").format(own, cell_text(value), small)
    std = _float(beside.get("std"))
    half = Markup(' data-half="{}"').format(half_interval(std)) if "std" in beside else ""
    sort = "" if value is None or (isinstance(value, float) and not isfinite(value)) else value
    return Markup('<td{} data-sort="{}"{}>{}</td>').format(
        own, sort, half, with_error(_float(value), std) if half else _number(column, value)
    )


def _class(column: Column) -> Markup:
    long = any(isinstance(cell, str) and len(cell) > LONG_TEXT for cell in column.cells)
    names = ["number"] * numeric(column.cells) + ["secondary"] * (column.kind == "minor") + ["words"] * long
    return Markup(' class="{}"').format(" ".join(names)) if names else Markup("")


def _number(column: Column, value: Cell) -> str:
    if isinstance(value, int):
        return str(value)
    return percentage(_float(value)) if column.unit == "%" else number(_float(value), column.digits)


def _float(value: Cell) -> float | None:
    return float(value) if isinstance(value, int | float) else None


@cache
def plotly_library(bundle: str) -> Markup:
    """The text of plotly.js 4.1.1 (MIT): its bundle `cartesian`, or `gl3d` with figures in space.

    The whole library is three times as large. The bundles are those of the npm packages plotly.js-cartesian-dist-min
    and plotly.js-gl3d-dist-min.
    """
    packed = files("ident.report").joinpath("assets", f"plotly-{bundle}.min.js.gz").read_bytes()
    return Markup(gzip.decompress(packed).decode())


def rendered(template: str, *packages: str, **context: Any) -> str:
    """A page, from its template of these packages or of the report."""
    return page_templates(*packages).get_template(f"{template}.html.j2").render(context)


@cache
def page_templates(*packages: str) -> Environment:
    """The templates of these packages and, behind them, those of the report: its style, script and macros.

    Their Python is kept in the cache folder: to generate it takes a quarter of a second in each process.

    They know the number filters, `dash`, `table_html`, and `plotlyjs(bundle)`, the plotting library as text. What they
    are given is escaped.
    The same packages get the same environment, whose templates are compiled once: that is most of what a page costs.
    """
    from jinja2 import ChoiceLoader, Environment, FileSystemBytecodeCache, PackageLoader, StrictUndefined
    from jinja2.bccache import Bucket

    class KeptWherePossible(FileSystemBytecodeCache):
        def dump_bytecode(self, bucket: Bucket) -> None:
            with suppress(OSError):  # a full disk costs time, not the page
                super().dump_bytecode(bucket)

    kept = None
    if hasattr(os, "getuid"):
        with suppress(OSError, RuntimeError):  # no folder that is the user's alone
            kept = KeptWherePossible(str(cache_folder()), "page-%s.cache")
    environment = Environment(
        loader=ChoiceLoader([PackageLoader(package) for package in (*packages, "ident.report")]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        bytecode_cache=kept,
    )
    environment.globals |= {"dash": number_text.DASH, "plotlyjs": plotly_library, "table_html": table_html}
    for name in ("number", "percent", "percentage", "whole", "with_error", "half_interval", "setting"):
        environment.filters[name] = getattr(number_text, name)
    return environment
