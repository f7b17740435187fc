"""Measured blocks of docs/measurements: what a page says of each, and what was printed put in its place."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
MEASUREMENTS = Path("docs/measurements")
MARK = re.compile(r"^\s*<!--\s*measured(?P<once> once)?:\s*(?P<text>.*?)\s*-->\s*$")
BELOW = re.compile(
    r"^\*(?:`(?P<command>[^`]+)`; version (?P<at>\S+, commit [0-9a-f]{7,40}, \d{4}-\d\d-\d\d)"
    r"|Measured once: (?P<reason>.+))\.\* <!-- block (?P<sum>[0-9a-f]{8}) -->$"
)
NUMBER = re.compile(
    r"(?<![\w.])[−+-]?\d{1,3}(?:[ ,]\d{3})+(?:\.\d+)?(?![\d])|(?<![\w.])[−+-]?\d+(?:\.\d+)?(?:[eE][−+-]?\d+)?"
)
RULE = re.compile(r"^\s*\|?[\s:|-]+\|[\s:|-]*$")
WITHIN = 0.02


@dataclass(frozen=True)
class Measurement:
    """How a table was measured.

    Attributes:
        command: of the study; empty where it cannot be measured again.
        skip: headings of columns left out.
        within: relative difference that is allowed.
        anywhere: whether the printed lines have another shape, so that numbers are looked for one by one.
        part: whether the page has a selection of the printed rows.
        reason: why it cannot be measured again.
    """

    command: str
    skip: tuple[str, ...] = ()
    within: float = WITHIN
    anywhere: bool = False
    part: bool = False
    reason: str = ""


@dataclass(frozen=True)
class Row:
    """Words and numbers of a table's row, those of skipped columns left out."""

    words: str
    numbers: tuple[str, ...]
    text: str


@dataclass(frozen=True)
class Block:
    """A table of a page, or what a command printed.

    Attributes:
        page: its path below the root.
        number: its place among the blocks of the page, from 0.
        line: of the heading, or of the line that opens the text, from 1.
        heading: its cells; empty of a text.
        rows: below.
        lines: how many lines the rows take.
        measurement: None where the page does not say.
        below: what the line below it says; None where there is none.
        checksum: of heading and rows.
    """

    page: str
    number: int
    line: int
    heading: tuple[str, ...]
    rows: tuple[Row, ...]
    lines: int
    measurement: Measurement | None
    below: re.Match[str] | None
    checksum: str

    @property
    def place(self) -> str:
        """Page and line."""
        return f"{self.page}:{self.line}"

    @property
    def at(self) -> str:
        """Version, commit and date of the measurement; empty where the page does not say."""
        return "" if self.below is None else self.below["at"] or ""

    @property
    def first(self) -> int:
        """Index of the first row's line in its page."""
        return self.line + 1 if self.heading else self.line

    @property
    def end(self) -> int:
        """Index of the line behind the block in its page."""
        return self.first + self.lines + (0 if self.heading else 1)

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
    within, anywhere, part = WITHIN, False, False
    for setting in settings:
        key, _, value = (part.strip() for part in setting.partition(":"))
        if key == "skip":
            skip = tuple(name.strip() for name in value.split(";"))
        elif key == "within":
            within = float(value.removesuffix("%")) / 100.0
        elif key == "anywhere":
            anywhere = True
        elif key == "part":
            part = True
        else:
            raise ValueError(f"'{key}' is none of 'skip', 'within', 'anywhere', 'part'")
    return Measurement(command, skip, within, anywhere, part)


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


def checksum_of(lines: Sequence[str]) -> str:
    """Eight digits that change with any character of the lines."""
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:8]


def blocks_of(page: str, text: str) -> Iterator[Block]:
    """Tables of a page and texts under a comment, in order.

    Raises:
        ValueError: a comment that cannot be read; names the place.
    """
    lines = text.splitlines()
    inside, number = False, 0
    for index, line in enumerate(lines):
        if line.startswith("```"):
            inside = not inside
        is_table = not inside and bool(RULE.match(line)) and index > 0 and lines[index - 1].strip().startswith("|")
        is_text = inside and line == "```text"
        if not (is_table or is_text):
            continue
        head = index - 1 if is_table else index
        try:
            above = [before for before in lines[:head][-2:] if before.strip()]
            measurement = measurement_of(above[-1]) if above else None
        except ValueError as error:
            raise ValueError(f"{page}:{head}: {error}") from None
        if is_text and measurement is None:
            continue
        heading = cells_of(lines[head]) if is_table else []
        skip = () if measurement is None else measurement.skip
        unknown = [name for name in skip if name not in heading]
        if unknown:
            raise ValueError(f"{page}:{head + 1}: the table has no column '{unknown[0]}'")
        content = []
        for following in lines[index + 1 :]:
            if following.strip().startswith("|") if is_table else following != "```":
                content.append(following)
            else:
                break
        skipped = [place for place, name in enumerate(heading) if name in skip]
        rows = tuple(row_of(cells_of(row) if is_table else [row], skipped) for row in content)
        end = index + 1 + len(content) + (1 if is_text else 0)
        behind = [after for after in lines[end : end + 2] if after.strip()]
        below = BELOW.match(behind[0]) if behind else None
        checksum = checksum_of([*(lines[head : index + 1] if is_table else []), *content])
        yield Block(page, number, head + 1, tuple(heading), rows, len(content), measurement, below, checksum)
        number += 1


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


def printed_tables(heading: Sequence[str], output: str) -> list[list[str]]:
    """Rows of every printed table with this heading."""
    found: list[list[str]] = []
    lines = output.splitlines()
    for index, line in enumerate(lines):
        if line.strip().startswith("|") and tuple(cells_of(line)) == tuple(heading):
            rows = []
            for row in lines[index + 1 :]:
                if not row.strip().startswith("|"):
                    break
                if not RULE.match(row):
                    rows.append(row)
            found.append(rows)
    return found


def selected(table: Block, lines: Sequence[str], printed: Sequence[str]) -> list[str]:
    """The printed rows of those of the page, by their first cells; empty where one has none, or several."""
    places = range(table.first, table.first + table.lines)
    for count in (1, 2, 3):
        by_key: dict[str, list[str]] = {}
        for line in printed:
            by_key.setdefault(row_key(cells_of(line)[:count]), []).append(line)
        found = [by_key.get(row_key(cells_of(lines[place])[:count]), []) for place in places]
        if all(len(candidates) == 1 for candidates in found):
            return [candidates[0] for candidates in found]
    return []


def rewritten(table: Block, lines: Sequence[str], output: str, place: tuple[int, int] = (0, 1)) -> list[str]:
    """Lines that take the place of the block's rows; empty where the output has none.

    Args:
        table: the block.
        lines: its page's.
        output: what the command printed.
        place: which of the blocks of this command and heading it is, and how many they are: printed in the same order.
    """
    assert table.measurement is not None
    if table.measurement.anywhere:
        return []
    if not table.heading:
        return [line.rstrip() for line in output.strip("\n").splitlines()]
    printed = printed_tables(table.heading, output)
    if len(printed) != place[1]:
        return []
    rows = printed[place[0]]
    return selected(table, lines, rows) if table.measurement.part else rows


def row_key(cells: Sequence[str]) -> str:
    """First cells of a row without their markup."""
    return " | ".join(re.sub(r"[`*\\]", "", cell) for cell in cells)


def reread(table: Block) -> Block:
    """The same block of its page as it is now, by its comment and heading: those above it may have changed."""
    blocks = list(blocks_of(table.page, (ROOT / table.page).read_text(encoding="utf-8")))
    alike = [block for block in blocks if (block.measurement, block.heading) == (table.measurement, table.heading)]
    return min(alike, key=lambda block: abs(block.number - table.number))


def write(table: Block, output: str, place: tuple[int, int]) -> bool:
    """Put what was printed in the block's place; whether that was possible. `place` as of `rewritten`."""
    page = ROOT / table.page
    lines = page.read_text(encoding="utf-8").split("\n")
    changed = rewritten(table, lines, output, place)
    if changed:
        lines[table.first : table.first + table.lines] = changed
        page.write_text("\n".join(lines), encoding="utf-8")
    return bool(changed)


def new_blocks(command: str, output: str, at: str) -> list[str]:
    """Lines of a page for what a command printed: its tables, each a block, or a text where it prints none."""
    lines = [line.rstrip() for line in output.strip("\n").splitlines()]
    groups: list[list[str]] = []
    for before, line in zip(["", *lines], lines, strict=False):
        if line.startswith("|"):
            if not before.startswith("|"):
                groups.append([])
            groups[-1].append(line)
    tables = [group for group in groups if len(group) > 1 and RULE.match(group[1])]
    page: list[str] = []
    for content in tables or [lines]:
        block = content if tables else ["```text", *content, "```"]
        below = f"*`{command}`; version {at}.* <!-- block {checksum_of(content)} -->"
        page += [f"<!-- measured: {command} -->", "", *block, "", below, ""]
    return page[:-1]


def replace_all(blocks: Sequence[Block], output: str, at: str) -> None:
    """Put what their command printed in the place of the first of these blocks, and take the others away."""
    for block in sorted(blocks, key=lambda one: (one.page, one.number), reverse=True):
        assert block.measurement is not None
        page = ROOT / block.page
        lines = page.read_text(encoding="utf-8").split("\n")
        start = max(at for at in range(block.line - 1) if MARK.match(lines[at]))
        below = [at for at in (block.end, block.end + 1) if at < len(lines) and BELOW.match(lines[at])]
        end = below[0] + 1 if below else block.end
        first = block.number == min(one.number for one in blocks) and block.page == min(one.page for one in blocks)
        if not first and end < len(lines) and not lines[end]:
            end += 1
        lines[start:end] = new_blocks(block.measurement.command, output, at) if first else []
        page.write_text("\n".join(lines), encoding="utf-8")


def stamp(table: Block, at: str) -> None:
    """Say below a block how and when it was measured, in place of what is said there.

    Args:
        table: as it is in its page now.
        at: version, commit and date; ignored of what was measured once.
    """
    assert table.measurement is not None
    page = ROOT / table.page
    lines = page.read_text(encoding="utf-8").split("\n")
    old = next((at for at in (table.end, table.end + 1) if at < len(lines) and BELOW.match(lines[at])), None)
    said = f"`{table.measurement.command}`; version {at}"
    if not table.measurement.command:
        said = f"Measured once: {table.measurement.reason}"
    lines[table.end : table.end if old is None else old + 1] = ["", f"*{said}.* <!-- block {table.checksum} -->"]
    page.write_text("\n".join(lines), encoding="utf-8")


def all_blocks(root: Path) -> list[Block]:
    """Blocks of all pages of the measurements."""
    pages = sorted((root / MEASUREMENTS).glob("*.md"))
    return [
        block
        for page in pages
        for block in blocks_of(page.relative_to(root).as_posix(), page.read_text(encoding="utf-8"))
    ]
