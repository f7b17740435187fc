"""Run the commands behind the tables of docs/ again, and name the tables that no longer agree with what they print.

    python studies/check.py [--list] [--write] [--seconds S] [WORD…]

A table says how it was measured in a comment above it:

    <!-- measured: python -m studies.payload.payload 40 | skip: CPU s; seconds | within: 3 % -->
    <!-- measured once: a UR10e that is no longer there -->

`skip` names columns that differ from run to run, by their headings: times of computation. `within` is the relative
difference that is allowed, 2 % where absent; a number may always differ by one of its last digit. A row of the table
is compared with the printed line of the same words; where there is none, with the one whose numbers are nearest.
`| anywhere` is for tables of another shape than what is printed, such as ranges over rows: each number must then be
among the printed ones, rounded. A command is run once, whatever the number of its tables. WORD keeps the tables whose
page or command contains it; `--list` runs nothing, and also names tables of figures that say nothing. `--write`
replaces stale rows by the printed ones of a table with the same heading; the text around is the author's to correct.
Exit status 1 where a table is stale.

Below a table stands when its figures were measured, for readers and for `--list`; `--write` renews it where the figures
agree or were replaced:

    *Measured at 0.1.0, commit 5e5a60a, 2026-11-22.*

All of it takes hours; a command ends after `--seconds` (3600).
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

MARK = re.compile(r"^\s*<!--\s*measured(?P<once> once)?:\s*(?P<text>.*?)\s*-->\s*$")
AT = re.compile(r"^\*Measured at (?P<at>\S+, commit [0-9a-f]{7,40}, \d{4}-\d\d-\d\d)\.\*$")
NUMBER = re.compile(
    r"(?<![\w.])[−+-]?\d{1,3}(?:[ ,]\d{3})+(?:\.\d+)?(?![\d])|(?<![\w.])[−+-]?\d+(?:\.\d+)?(?:[eE][−+-]?\d+)?"
)
RULE = re.compile(r"^\s*\|?[\s:|-]+\|[\s:|-]*$")
WITHIN = 0.02
SECONDS = 3600.0
OFFERED = 3
"""Stale rows that are shown per table."""


@dataclass(frozen=True)
class Measurement:
    """How a table was measured.

    Attributes:
        command: of the study; empty where it cannot be measured again.
        skip: headings of columns left out.
        within: relative difference that is allowed.
        anywhere: whether the printed lines have another shape, so that numbers are looked for one by one.
        reason: why it cannot be measured again.
    """

    command: str
    skip: tuple[str, ...] = ()
    within: float = WITHIN
    anywhere: bool = False
    reason: str = ""


@dataclass(frozen=True)
class Row:
    """Words and numbers of a table's row, those of skipped columns left out."""

    words: str
    numbers: tuple[str, ...]
    text: str


@dataclass(frozen=True)
class DocsTable:
    """A table of a page.

    Attributes:
        page: its name.
        line: of the heading, from 1.
        heading: its cells.
        rows: below.
        measurement: None where the page does not say.
        at: version, commit and date of the measurement; empty where the page does not say.
    """

    page: str
    line: int
    heading: tuple[str, ...]
    rows: tuple[Row, ...]
    measurement: Measurement | None
    at: str = ""

    @property
    def place(self) -> str:
        """Page and line."""
        return f"docs/{self.page}:{self.line}"

    @property
    def of_figures(self) -> bool:
        """Whether half of its rows hold more digits than letters, their first cell left out."""
        inner = [row.text.partition("|")[2] for row in self.rows]
        figures = sum(sum(map(str.isdigit, text)) > sum(map(str.isalpha, text)) for text in inner)
        return 2 * figures >= len(inner) > 0


def measurement_of(line: str) -> Measurement | None:
    """What a comment says; None where the line is none.

    Raises:
        ValueError: a key that is not known, or no command.
    """
    found = MARK.match(line)
    if found is None:
        return None
    if found["once"]:
        return Measurement("", reason=found["text"])
    command, *settings = (part.strip() for part in found["text"].split("|"))
    if not command.startswith("python -m studies."):
        raise ValueError(f"'{command}' is not the command of a study")
    skip: tuple[str, ...] = ()
    within, anywhere = WITHIN, False
    for setting in settings:
        key, _, value = (part.strip() for part in setting.partition(":"))
        if key == "skip":
            skip = tuple(name.strip() for name in value.split(";"))
        elif key == "within":
            within = float(value.removesuffix("%")) / 100.0
        elif key == "anywhere":
            anywhere = True
        else:
            raise ValueError(f"'{key}' is none of 'skip', 'within', 'anywhere'")
    return Measurement(command, skip, within, anywhere)


def cells_of(line: str) -> list[str]:
    """Cells of a table's line."""
    inner = line.strip().removeprefix("|").removesuffix("|").replace(r"\|", "\0")
    return [cell.replace("\0", "|").strip() for cell in inner.split("|")]


def row_of(cells: Sequence[str], skipped: Sequence[int] = ()) -> Row:
    """Words and numbers of cells."""
    kept = [cell for place, cell in enumerate(cells) if place not in skipped]
    text = " | ".join(kept)
    plain = re.sub(r"[`*_\\]", "", text)
    numbers = tuple(NUMBER.findall(plain))
    words = " ".join(re.sub(r"[^\w]+", " ", NUMBER.sub(" ", plain)).lower().split())
    return Row(words, numbers, text)


def tables_of(page: str, text: str) -> Iterator[DocsTable]:
    """Tables of a page, in order.

    Raises:
        ValueError: a comment that cannot be read; names the place.
    """
    lines = text.splitlines()
    for index in range(1, len(lines)):
        if not (RULE.match(lines[index]) and lines[index - 1].strip().startswith("|")):
            continue
        heading = cells_of(lines[index - 1])
        try:
            above = [line for line in lines[: index - 1][-2:] if line.strip()]
            measurement = measurement_of(above[-1]) if above else None
        except ValueError as error:
            raise ValueError(f"docs/{page}:{index - 1}: {error}") from None
        skip = () if measurement is None else measurement.skip
        unknown = [name for name in skip if name not in heading]
        if unknown:
            raise ValueError(f"docs/{page}:{index}: the table has no column '{unknown[0]}'")
        skipped = [place for place, name in enumerate(heading) if name in skip]
        rows = []
        for line in lines[index + 1 :]:
            if not line.strip().startswith("|"):
                break
            rows.append(row_of(cells_of(line), skipped))
        below = [line for line in lines[index + 1 + len(rows) :][:2] if line.strip()]
        found = AT.match(below[0]) if below else None
        yield DocsTable(page, index, tuple(heading), tuple(rows), measurement, found["at"] if found else "")


def printed_rows(output: str, skip: Sequence[str]) -> list[Row]:
    """Lines that a study printed; of its tables without the skipped columns."""
    rows: list[Row] = []
    skipped: list[int] = []
    lines = output.splitlines()
    for index, line in enumerate(lines):
        if RULE.match(line) or not line.strip():
            continue
        if not line.strip().startswith("|"):
            rows.append(row_of([line]))
        elif index + 1 < len(lines) and RULE.match(lines[index + 1]):
            skipped = [place for place, name in enumerate(cells_of(line)) if name in skip]
        else:
            rows.append(row_of(cells_of(line), skipped))
    return rows


def value_of(number: str) -> float:
    """The number."""
    return float(number.replace("−", "-").replace(",", "").replace(" ", ""))


def last_digit(number: str) -> float:
    """What one of the last digit is worth."""
    mantissa, _, exponent = number.lower().replace("−", "-").partition("e")
    decimals = len(mantissa.partition(".")[2])
    return 10.0 ** (int(exponent or 0) - decimals)


def agree(stated: str, measured: str, within: float) -> bool:
    """Whether a number of the docs is that of the study, within its tolerance or one of its last digit."""
    difference = abs(value_of(stated) - value_of(measured))
    return difference <= max(within * abs(value_of(measured)), last_digit(stated)) * (1.0 + 1e-9)


def rounds_to(stated: str, measured: str) -> bool:
    """Whether a number of the docs is that of the study, rounded to the digits stated; or a share in percent."""
    value, allowed = value_of(stated), 0.501 * last_digit(stated)
    return any(abs(value - factor * value_of(measured)) <= allowed for factor in (1.0, 100.0))


def wrong_numbers(stated: Row, measured: Row, within: float) -> int:
    """How many numbers of two rows differ; all where they have different numbers of them."""
    if len(stated.numbers) != len(measured.numbers):
        return max(len(stated.numbers), len(measured.numbers))
    pairs = zip(stated.numbers, measured.numbers, strict=True)
    return sum(not agree(*pair, within) for pair in pairs)


def stale_rows(table: DocsTable, printed: Sequence[Row]) -> list[tuple[Row, str]]:
    """Rows of the table that differ from what was printed, each with what was compared."""
    assert table.measurement is not None
    measurement, found = table.measurement, []
    everything = [number for other in printed for number in other.numbers] if measurement.anywhere else []
    for row in table.rows:
        if not row.numbers:
            continue
        if measurement.anywhere:
            missing = [number for number in row.numbers if not any(rounds_to(number, other) for other in everything)]
            if missing:
                found.append((row, f"no {', '.join(missing)}"))
            continue
        same = [other for other in printed if other.words == row.words]
        candidates = same or [other for other in printed if len(other.numbers) == len(row.numbers)]
        wrong = [(wrong_numbers(row, other, measurement.within), other) for other in candidates]
        count, nearest = min(wrong, key=lambda pair: pair[0], default=(1, None))
        if count:
            found.append((row, "nothing like it" if nearest is None else nearest.text))
    return found


def run(command: str, seconds: float) -> tuple[str, str]:
    """What a study printed, and what went wrong; the latter is empty where nothing did."""
    words = shlex.split(command)
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            [sys.executable, *words[1:]],
            cwd=ROOT,
            env=environment,
            capture_output=True,
            text=True,
            timeout=seconds,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return "", f"not finished after {seconds:g} s"
    if done.returncode:
        last = done.stderr.strip().splitlines()[-1:] or ["no message"]
        return done.stdout, f"exit status {done.returncode}: {last[0]}"
    return done.stdout, ""


def rewritten(table: DocsTable, lines: Sequence[str], output: str) -> dict[int, str]:
    """Lines of a page, by index, that printed rows of a table with the same heading replace, each by its first cells.

    Empty where a row has no printed one, or several. `lines` are the page's.
    """
    printed: list[tuple[list[str], str]] = []
    inside = False
    for line in output.splitlines():
        cells = cells_of(line) if line.strip().startswith("|") else []
        inside = bool(cells) and (inside or tuple(cells) == table.heading)
        if inside and tuple(cells) != table.heading and not RULE.match(line):
            printed.append((cells, line))
    places = range(table.line + 1, table.line + 1 + len(table.rows))
    for count in (1, 2, 3):
        by_key: dict[str, list[str]] = {}
        for cells, line in printed:
            by_key.setdefault(row_key(cells[:count]), []).append(line)
        found = {place: by_key.get(row_key(cells_of(lines[place])[:count]), []) for place in places}
        if all(len(candidates) == 1 for candidates in found.values()):
            return {place: candidates[0] for place, candidates in found.items()}
    return {}


def row_key(cells: Sequence[str]) -> str:
    """First cells of a row without their markup."""
    return " | ".join(re.sub(r"[`*\\]", "", cell) for cell in cells)


def write(table: DocsTable, output: str) -> bool:
    """Put the printed rows in the table's place; whether that was possible."""
    page = ROOT / "docs" / table.page
    lines = page.read_text(encoding="utf-8").split("\n")
    changed = rewritten(table, lines, output)
    for place, line in changed.items():
        lines[place] = line
    page.write_text("\n".join(lines), encoding="utf-8")
    return bool(changed)


def stamp(table: DocsTable, at: str) -> None:
    """Say below a table when it was measured, in place of what is said there."""
    page = ROOT / "docs" / table.page
    lines = page.read_text(encoding="utf-8").split("\n")
    end = table.line + 1 + len(table.rows)
    old = next((place for place in (end, end + 1) if place < len(lines) and AT.match(lines[place])), None)
    lines[end : end if old is None else old + 1] = ["", f"*Measured at {at}.*"]
    page.write_text("\n".join(lines), encoding="utf-8")


def now() -> str:
    """Version, commit and date of this moment."""
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return f"{version('dynid')}, commit {commit.stdout.strip()}, {datetime.now(UTC):%Y-%m-%d}"


def all_tables(folder: Path) -> list[DocsTable]:
    """Tables of all pages."""
    pages = sorted(folder.glob("*.md"))
    return [table for page in pages for table in tables_of(page.name, page.read_text(encoding="utf-8"))]


def chosen(tables: Sequence[DocsTable], words: Sequence[str]) -> list[DocsTable]:
    """Those whose page or command contains one of the words; all where there is none."""

    def wanted(table: DocsTable) -> bool:
        command = table.measurement.command if table.measurement else ""
        return not words or any(word in table.page or word in command for word in words)

    return [table for table in tables if wanted(table)]


def show_list(tables: Sequence[DocsTable]) -> None:
    """Commands with their tables, and tables that say nothing."""
    for table in tables:
        when = f"measured at {table.at}" if table.at else "does not say when it was measured"
        if table.measurement is None:
            if table.of_figures:
                print(f"{table.place}: does not say how it was measured")
        elif table.measurement.command:
            print(f"{table.place}: {table.measurement.command}; {when}")
        else:
            print(f"{table.place}: measured once: {table.measurement.reason}")


def check(tables: Sequence[DocsTable], seconds: float, *, writing: bool = False) -> bool:
    """Run, compare, report; whether all agree."""
    commands = dict.fromkeys(t.measurement.command for t in tables if t.measurement and t.measurement.command)
    good, done = True, list[DocsTable]()
    for command in commands:
        of_command = [t for t in tables if t.measurement and t.measurement.command == command]
        print(f"{command} …", flush=True)
        output, failure = run(command, seconds)
        for table in of_command:
            assert table.measurement is not None
            stale = stale_rows(table, printed_rows(output, table.measurement.skip))
            good &= not stale and not failure
            if failure:
                print(f"  {table.place}: FAILED ({failure})", flush=True)
            elif stale:
                print(f"  {table.place}: STALE, {len(stale)} of {len(table.rows)} rows, {table.at}", flush=True)
                if writing and write(table, output):
                    print("    written: look at the text around it", flush=True)
                    done.append(table)
                    continue
                for row, measured in stale[:OFFERED]:
                    print(f"    docs:    {row.text}\n    printed: {measured}")
            else:
                print(f"  {table.place}: as printed", flush=True)
                done.append(table)
    if writing:
        for table in sorted(done, key=lambda one: -one.line):  # a stamp may move what is below it
            stamp(table, now())
    return good


def main() -> int:
    """Check the tables; 1 where one is stale."""
    assert __doc__ is not None
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("words", nargs="*", metavar="WORD", help="pages or commands; all if absent")
    parser.add_argument("--list", action="store_true", help="show the tables and their commands, and run nothing")
    parser.add_argument("--write", action="store_true", help="put printed rows in the place of stale ones where it can")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="time limit of a command")
    arguments = parser.parse_args()
    try:
        tables = chosen(all_tables(ROOT / "docs"), arguments.words)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    if arguments.list:
        show_list(tables)
        return 0
    good = check(tables, arguments.seconds, writing=arguments.write)
    show_list([table for table in tables if table.measurement is None])
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
