"""Tables with units: printed, shown in a notebook, or converted to a data frame."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape
from typing import TYPE_CHECKING, Literal

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from drivers.core.text import DASH, percentage_text

if TYPE_CHECKING:
    from pandas import DataFrame

Cell = str | float | int | bool | None

Kind = Literal["plain", "std", "detail", "minor"]


@dataclass(frozen=True)
class Column:
    """One column of a table."""

    name: str  # for programs
    cells: tuple[Cell, ...] = ()  # one per row; None where a row has no value
    unit: str = ""  # empty where there is none
    label: str = ""  # for people; the name where it is empty
    # `std` is σ of the column before it, `detail` belongs under it in small print; a page has neither as a column of
    # its own. `minor` is what narrow paper can do without.
    kind: Kind = "plain"
    digits: int = 4  # significant ones on a page

    @property
    def heading(self) -> str:
        """Label and unit; σ has that of the column before it."""
        label = self.label or self.name.replace("_", " ")
        return f"{label} [{self.unit}]" if self.unit and self.kind != "std" else label

    @property
    def texts(self) -> tuple[str, ...]:
        """The cells for people."""
        return tuple(cell_text(cell, self.unit) for cell in self.cells)


@dataclass(frozen=True)
class Table:
    """Named rows and columns of numbers and texts, with units; what `result.parameters` and others are.

    `table["value"]` is a column as an array (NaN where a cell is empty), `table.row("Fv1")` a row as a mapping;
    `len(table)` counts the rows, and iterating gives them in order. `print(table)` writes plain text, a notebook shows
    HTML.

    Attributes:
        title: what the table holds.
        columns: in order; the first one names the rows.
        note: sentences below it; empty where there are none.

    Example:
        >>> import dynid
        >>> table = dynid.base_parameters("ur5e")
        >>> table.row("Fv1")["unit"]
        'N·m·s/rad'
        >>> table.names[:2], len(table) == len(table["kind"])
        (('ZZR1', 'XXR2'), True)
    """

    title: str
    columns: tuple[Column, ...]
    note: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        """The rows' names: the cells of the first column."""
        return tuple(str(cell) for cell in self.columns[0].cells)

    def __len__(self) -> int:
        return len(self.columns[0].cells)

    def __iter__(self) -> Iterator[Mapping[str, Cell]]:
        return (self._row(row) for row in range(len(self)))

    def __getitem__(self, name: str) -> np.ndarray:
        """A column as an array: of numbers (NaN where a cell is empty), or of texts.

        Raises:
            UsageError: there is no such column.
        """
        for column in self.columns:
            if column.name == name:
                return _array(column.cells)
        names = ", ".join(column.name for column in self.columns)
        raise UsageError(f"the table has no column '{name}'", hint=f"columns: {names}")

    def row(self, name: str) -> Mapping[str, Cell]:
        """The row of this name as column → cell.

        Raises:
            UsageError: there is no such row.
        """
        if name not in self.names:
            raise UsageError(f"the table has no row '{name}'", hint=f"rows: {', '.join(self.names)}")
        return self._row(self.names.index(name))

    def pick(self, *names: str) -> Table:
        """The table with only these columns, in this order.

        Raises:
            UsageError: there is no such column.
        """
        by_name = {column.name: column for column in self.columns}
        for name in names:
            self[name]
        return replace(self, columns=tuple(by_name[name] for name in names))

    def in_order(self, rows: Sequence[int]) -> Table:
        """The table with these rows, in this order."""
        columns = (replace(column, cells=tuple(column.cells[row] for row in rows)) for column in self.columns)
        return replace(self, columns=tuple(columns))

    def to_frame(self) -> DataFrame:
        """The table as a pandas data frame, indexed by the rows' names; units in `frame.attrs["units"]`.

        Raises:
            UsageError: pandas is not installed.
        """
        try:
            import pandas
        except ImportError as error:
            raise UsageError("a data frame needs pandas", hint="pip install 'dynid[frames]'") from error
        first, *others = self.columns
        index = pandas.Index(list(first.cells), name=first.name)
        frame = pandas.DataFrame({column.name: list(column.cells) for column in others}, index=index)
        frame.attrs["units"] = {column.name: column.unit for column in others if column.unit}
        return frame

    def _row(self, row: int) -> dict[str, Cell]:
        return {column.name: column.cells[row] for column in self.columns}

    def __repr__(self) -> str:
        return f"<dynid.Table {self.title!r}, {len(self)} rows: {', '.join(column.name for column in self.columns)}>"

    def __str__(self) -> str:
        texts = [[column.heading, *column.texts] for column in self.columns]
        numbers = [numeric(column.cells) for column in self.columns]
        widths = [max(map(len, column)) for column in texts]
        lines = [
            "  ".join(
                text.rjust(width) if right else text.ljust(width)
                for text, width, right in zip(row, widths, numbers, strict=True)
            ).rstrip()
            for row in zip(*texts, strict=True)
        ]
        return "\n".join([self.title, *lines, *([self.note] if self.note else [])])

    def _repr_html_(self) -> str:
        head = "".join(f"<th>{escape(column.heading)}</th>" for column in self.columns)
        align = ["right" if numeric(column.cells) else "left" for column in self.columns]
        rows = "".join(
            "<tr>"
            + "".join(
                f'<td style="text-align: {side}">{escape(column.texts[row])}</td>'
                for column, side in zip(self.columns, align, strict=True)
            )
            + "</tr>"
            for row in range(len(self))
        )
        caption = f"<caption>{escape(self.title)}</caption>"
        note = f"<p>{escape(self.note)}</p>" if self.note else ""
        return f"<table>{caption}<thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>{note}"


def table_of_rows(title: str, columns: Sequence[Column | tuple[str, str]], rows: Sequence[Sequence[Cell]]) -> Table:
    """A table from rows; `columns` are without cells, or a name and a unit each."""
    empty = [column if isinstance(column, Column) else Column(column[0], unit=column[1]) for column in columns]
    cells = list(zip(*rows, strict=True)) if rows else [()] * len(empty)
    return Table(title, tuple(replace(blank, cells=tuple(own)) for blank, own in zip(empty, cells, strict=True)))


def table_of(title: str, columns: Sequence[Column], rows: Sequence[object]) -> Table:
    """A table of objects, whose attributes of the columns' names are the cells."""
    return table_of_rows(title, columns, [[getattr(row, column.name) for column in columns] for row in rows])


def cell_text(cell: Cell, unit: str = "") -> str:
    """A cell for people: four significant digits, percentages as people write them, a dash for nothing."""
    if cell is None or (isinstance(cell, float) and not math.isfinite(cell)):
        return DASH
    if isinstance(cell, float) and unit == "%":
        return percentage_text(cell)
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    return f"{cell:.4g}" if isinstance(cell, float) else str(cell)


def numeric(cells: Sequence[Cell]) -> bool:
    """Return whether a column holds numbers."""
    there = [cell for cell in cells if cell is not None]
    return bool(there) and all(isinstance(cell, (int, float)) and not isinstance(cell, bool) for cell in there)


def _array(cells: Sequence[Cell]) -> np.ndarray:
    if any(isinstance(cell, (str, bool)) for cell in cells):
        return np.array(cells)
    numbers: FloatArray = np.array([np.nan if cell is None else cell for cell in cells], dtype=np.float64)
    return numbers
