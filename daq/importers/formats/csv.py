"""CSV: comma, semicolon, tab or blanks between the columns; a header, perhaps units below it, or column numbers."""

from __future__ import annotations

import re
from collections.abc import Container, Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from daq.importers.choices import ImportChoices
from daq.importers.collecting import collect
from daq.importers.naming import TIMES
from daq.importers.roles import assign_roles
from daq.importers.table import ForeignTable, Note, listed, printable
from drivers.core.arrays import FloatArray
from drivers.core.errors import ImportFileError
from drivers.core.files import TEXT_TABLE, read_bytes

_SEPARATORS = (";", "\t", ",")
_SEPARATOR_NAMES = {";": "semicolon", "\t": "tab", ",": "comma", None: "blanks"}
_DECIMAL_COMMA = re.compile(r"^[+-]?\d+,\d+([eE][+-]?\d+)?$")
_BRACKET = re.compile(r"[\[(]")
_UNIT = re.compile(r"^[^\W\d_][\w°µ·*/^²³ .-]*$|^°$")
_MISSING = frozenset({"", "na", "n/a", "null", "none", "-"})
_EXAMPLE = "t,q1,q2,…,torque1,torque2,…"


def read_csv(path: Path, joints: Sequence[str], choices: ImportChoices) -> ForeignTable:
    """Read a CSV file; columns are recognised by their header or chosen by number, units in brackets are honoured.

    So are units in a line of their own under the header. Numbers have a decimal point, or a comma where semicolons or
    tabs are between the columns. Lines that begin with # are comments; `choices.columns` maps headers without a
    meaning, or column numbers where there is no header.

    Times may be ISO 8601 dates.

    Raises:
        ImportFileError: not text, no header, no rows, a row of another length, something that is not a number; with
            the line.
    """
    where = str(path)
    lines, line_numbers, comments = _significant_lines(_decoded(path), where)
    notes: list[Note] = []
    units: dict[str, str] = {}
    header = lines[0]
    separator = next((mark for mark in _SEPARATORS if mark in header), None)
    names = _split_header(header, separator)
    if _is_numeric(names):
        commented = _split_header(comments.get(line_numbers[0] - 1, ""), separator)
        if len(commented) == len(names) and not _is_numeric(commented):
            notes.append(Note("info", f"the header was taken from the comment in line {line_numbers[0] - 1}"))
            names = commented
        elif choices.columns:
            names = [f"column {position}" for position in range(1, len(names) + 1)]
        else:
            raise ImportFileError(
                "begins with numbers instead of a header",
                where=f"{where}, line {line_numbers[0]}",
                hint=f"name the columns: --column t=1 --column position=2-{1 + len(joints)}; "
                f"or add a line such as {_EXAMPLE}",
            )
    else:
        lines, line_numbers = lines[1:], line_numbers[1:]
        if lines and (units := _units(names, _split(lines[0], separator))):
            notes.append(Note("info", f"the units were taken from line {line_numbers[0]}"))
            lines, line_numbers = lines[1:], line_numbers[1:]
    if separator in (";", "\t") and _has_decimal_commas(lines, separator):
        notes.append(Note("info", "decimal commas were read"))
        lines = [line.replace(",", ".") for line in lines]
    if not lines:
        raise ImportFileError("has a header, but no rows of numbers under it", where=where)
    _check_columns(lines, line_numbers, names, separator, where)
    if len(names) > 1 and names[-1] == "":
        names = names[:-1]
    roles = assign_roles(names, joints, choices.columns, where, numbered=True)
    used = sorted({names.index(role.name) for role in roles})
    if not used:
        raise ImportFileError(
            f"has no column with a recognised name; it has: {listed(names)}",
            where=where,
            hint=f"name the columns like {_EXAMPLE}, or map them: --column q1={printable(names[0])}",
        )
    times = {names.index(role.name) for role in roles if role.quantity in TIMES}
    values = _values(lines, line_numbers, names, used, times, separator, where)
    return collect(
        f"CSV ({_SEPARATOR_NAMES[separator]})",
        roles,
        {names[column]: values[:, place] for place, column in enumerate(used)},
        joints,
        where,
        units=units,
        unused=[name for column, name in enumerate(names) if column not in set(used)],
        notes=notes,
        lines=np.asarray(line_numbers, dtype=np.int64),
    )


def _decoded(path: Path) -> str:
    content = read_bytes(path, TEXT_TABLE, ImportFileError)
    encoding = "utf-16" if content[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    if encoding == "utf-8-sig" and b"\0" in content:
        line = content[: content.index(b"\0")].count(b"\n") + 1
        raise ImportFileError("is not a text file: it holds zero bytes", where=f"{path}, line {line}")
    try:
        return content.decode(encoding)
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        raise ImportFileError(
            f"is not {encoding.removesuffix('-sig').upper()} text: {error.reason}",
            where=f"{path}, line {line}",
            hint="save it as UTF-8",
        ) from error


def _significant_lines(text: str, where: str) -> tuple[list[str], list[int], dict[int, str]]:
    """Lines that hold something, their numbers from 1, and the comments by number."""
    lines, line_numbers, comments = [], [], {}
    for line_number, line in enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), start=1):
        stripped = line.strip(" ")
        if stripped.startswith("#"):
            comments[line_number] = stripped.lstrip("# ")
        elif stripped.strip():
            lines.append(stripped)
            line_numbers.append(line_number)
    if not lines:
        raise ImportFileError("is empty" if not comments else "holds nothing but comments", where=where)
    return lines, line_numbers, comments


def _split(line: str, separator: str | None) -> list[str]:
    return [field.strip().strip('"').strip() for field in line.split(separator)]


def _split_header(line: str, separator: str | None) -> list[str]:
    # With blanks between the columns, the one in `q1 [deg]` is part of the name.
    return _split(re.sub(r"\s+(?=[\[(])", "", line) if separator is None else line, separator)


def _number(field: str) -> float | None:
    """The value of a field, NaN for a missing one, None for one that is not a number."""
    if field.casefold() in _MISSING:
        return float("nan")
    # float() would also take 1_000, which no instrument writes.
    if "_" in field:
        return None
    try:
        return float(field)
    except ValueError:
        return None


def _date(field: str) -> float | None:
    """The seconds after 1970 of an ISO 8601 date with time, UTC where it names no zone; None for anything else."""
    try:
        date = datetime.fromisoformat(field)
    except ValueError:
        return None
    return (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp()


def _is_numeric(fields: Sequence[str]) -> bool:
    return any(field and (_number(field) is not None or _DECIMAL_COMMA.match(field)) for field in fields) and all(
        _number(field) is not None or _DECIMAL_COMMA.match(field) for field in fields
    )


def _units(names: list[str], fields: list[str]) -> dict[str, str]:
    """The units of the columns from the line under their names; empty where that holds anything else."""
    units = ["" if field.casefold() in _MISSING else field.strip("[]()") for field in fields]
    if len(fields) != len(names) or not any(units) or any(_BRACKET.search(name) for name in names):
        return {}
    if any(unit and (_number(unit) is not None or not _UNIT.match(unit)) for unit in units):
        return {}
    return dict(zip(names, units, strict=True))


def _has_decimal_commas(lines: list[str], separator: str) -> bool:
    """Whether commas in the numbers can only be decimal: no point is among them, and not all have three digits after.

    Thousands have three digits after a comma.
    """
    if any("." in line for line in lines):
        return False
    fields = [field for line in lines for field in _split(line, separator) if "," in field]
    return all(_DECIMAL_COMMA.match(field) for field in fields) and any(len(f.split(",")[1]) != 3 for f in fields)


def _check_columns(
    lines: list[str], line_numbers: list[int], names: list[str], separator: str | None, where: str
) -> None:
    expected = len(names)
    for place, line in enumerate(lines):
        count = line.count(separator) + 1 if separator is not None else len(line.split())
        if count == expected:
            continue
        hint = ""
        if place == len(lines) - 1 and count < expected:
            hint = "it is the last line and seems cut off; delete it"
        elif separator == "," and count > expected and count % 2 == 0:
            hint = "numbers must have a decimal point, not a comma"
        elif separator is not None and count == expected + 1 and line.endswith(separator):
            hint = "the line ends with a separator that the header does not have"
        raise ImportFileError(
            f"has {count} columns, but the header has {expected}",
            where=f"{where}, line {line_numbers[place]}",
            hint=hint,
        )


def _values(
    lines: list[str],
    line_numbers: list[int],
    names: list[str],
    used: list[int],
    times: Container[int],
    separator: str | None,
    where: str,
) -> FloatArray:
    """(N, used) numbers, dates in `times` as s after 1970; NumPy first, ours where it fails, to name the place."""
    try:
        fast: FloatArray = np.loadtxt(
            lines, delimiter=separator, usecols=used, ndmin=2, comments=None, quotechar='"', dtype=np.float64
        )
        if fast.shape == (len(lines), len(used)):
            return fast
    except ValueError:
        pass
    values = np.empty((len(lines), len(used)))
    for row, line in enumerate(lines):
        fields = _split(line, separator)
        for place, column in enumerate(used):
            value = _number(fields[column])
            if value is None and column in times:
                value = _date(fields[column])
            if value is None:
                raise _not_a_number(
                    fields[column], f"{where}, line {line_numbers[row]}, column {printable(names[column])}"
                )
            values[row, place] = value
    return values


def _not_a_number(field: str, where: str) -> ImportFileError:
    if _DECIMAL_COMMA.match(field):
        return ImportFileError(
            f"'{printable(field)}' has a decimal comma",
            where=where,
            hint="export it with a decimal point, or with semicolons between the columns",
        )
    return ImportFileError(f"'{printable(field)}' is not a number", where=where)
