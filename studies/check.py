"""Run the commands behind the figures of docs/measurements again; name what is stale, or write it anew.

    python studies/check.py [--list] [--write] [--outputs FOLDER] [--seconds S] [WORD…]

Tables of figures stand in docs/measurements alone, one page per topic. Each is a block of a page: a Markdown table, or
what a command prints between ```text and ```. A comment above it says how it was measured, a line below it shows this
to the reader, with version, commit and date, and ends with a checksum of the block, which no edit by hand keeps:

    <!-- measured: python -m studies.payload.payload 40 | skip: CPU s; seconds | within: 3 % -->
    <!-- measured once: a UR10e that is no longer there -->

    *`python -m studies.payload.payload 40`; version 0.1.0, commit 5e5a60a, 2026-11-22.* <!-- block 1a2b3c4d -->

`--write` replaces a stale block: a table by the printed one of the same heading, a text by all that was printed. It
renews the line below, also where the figures agree. Settings of the comment:

- `skip` names columns that differ from run to run, by their headings: times of computation;
- `within` is the relative difference that is allowed, 2 % where absent; a number may always differ by one of its last
  digit. A row is compared with the printed line of the same words, else, where no table with this heading is printed,
  with the one whose numbers are nearest;
- `part`: the page has a selection of the printed rows; `--write` keeps to it;
- `anywhere`: the block has another shape than what is printed: each of its numbers must be among the printed ones,
  rounded. It was made by hand; `--write` puts the printed tables, or else all that was printed, in its place, and in
  that of a table whose heading is no longer printed.

A command is run once, whatever the number of its blocks. WORD keeps the blocks whose page or command contains it.
`--list` runs nothing. With `--outputs` what each command printed is kept in a folder, with the commit that printed it,
and what is there is not measured again. Exit status 1 where a block is stale or names a commit that does not exist.

All of it takes hours; a command ends after `--seconds` (3600).
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from studies import pages

KEPT = re.compile(r"^# (?P<command>[^|]+?) \| (?P<at>\S+, commit [0-9a-f]{7,40}, \d{4}-\d\d-\d\d)")
COMMIT = re.compile(r"\b(?:commits?|at|and|to) ([0-9a-f]{7,40})\b")
SECONDS = 3600.0
OFFERED = 3
"""Stale rows that are shown per table."""


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


def wrong_numbers(stated: pages.Row, measured: pages.Row, within: float) -> int:
    """How many numbers of two rows differ; all where they have different numbers of them."""
    if len(stated.numbers) != len(measured.numbers):
        return max(len(stated.numbers), len(measured.numbers))
    pairs = zip(stated.numbers, measured.numbers, strict=True)
    return sum(not agree(*pair, within) for pair in pairs)


def stale_rows(table: pages.Block, output: str) -> list[tuple[pages.Row, str]]:
    """Rows of the table that differ from what was printed, each with what was compared."""
    assert table.measurement is not None
    measurement, found = table.measurement, []
    printed = pages.printed_rows(output, measurement.skip)
    everything = [number for other in printed for number in other.numbers] if measurement.anywhere else []
    alike = [] if measurement.anywhere else pages.printed_tables(table.heading, output)
    # words too are compared where this table was printed, and where no row holds a number
    by_words = bool(alike) or not any(row.numbers for row in table.rows)
    words = {other.words for other in printed}
    if len(alike) == 1 and not measurement.part and len(alike[0]) > len(table.rows):
        found.append((table.rows[-1], f"{len(alike[0])} rows in place of {len(table.rows)}"))
    for row in table.rows:
        if by_words and row.words not in words:
            found.append((row, "no such row"))
        if not row.numbers or (by_words and row.words not in words):
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
    words, env = [sys.executable, *shlex.split(command)[1:]], {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            words, cwd=pages.ROOT, env=env, capture_output=True, text=True, timeout=seconds, check=False
        )
    except subprocess.TimeoutExpired:
        return "", f"not finished after {seconds:g} s"
    if done.returncode:
        last = done.stderr.strip().splitlines()[-1:] or ["no message"]
        return done.stdout, f"exit status {done.returncode}: {last[0]}"
    return done.stdout, ""


def now() -> str:
    """Version, commit and date of this moment."""
    commit = subprocess.check_output(["git", "rev-parse", "--short", "HEAD"], cwd=pages.ROOT, text=True).strip()
    return f"{version('dynid')}, commit {commit}, {datetime.now(UTC):%Y-%m-%d}"


def chosen(tables: Sequence[pages.Block], words: Sequence[str]) -> list[pages.Block]:
    """Those whose page or command contains one of the words; all where there is none."""

    def wanted(table: pages.Block) -> bool:
        command = table.measurement.command if table.measurement else ""
        return not words or any(word in table.page or word in command for word in words)

    return [table for table in tables if wanted(table)]


def show_list(tables: Sequence[pages.Block]) -> None:
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


def missing_commits(tables: Sequence[pages.Block]) -> list[str]:
    """What is measured at a commit that is not in this repository."""
    found = []
    for table in tables:
        for commit in COMMIT.findall("" if table.below is None else table.below[0]):
            git = ["git", "cat-file", "-e", commit + "^{commit}"]
            if subprocess.run(git, cwd=pages.ROOT, capture_output=True, check=False).returncode:
                found.append(f"{table.place}: there is no commit {commit}")
    return found


def output_of(command: str, seconds: float, outputs: Path | None) -> tuple[str, str, str]:
    """What a study printed, now or as kept in `outputs`; what went wrong; version, commit and date."""
    kept = None if outputs is None else outputs / (re.sub(r"\W+", "_", command) + ".txt")
    if kept is not None and kept.is_file():
        first, _, output = kept.read_text(encoding="utf-8").partition("\n")
        found = KEPT.match(first)
        if found is not None and found["command"] == command:
            return output, "", found["at"]
    at = now()
    output, failure = run(command, seconds)
    if kept is not None and not failure:
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_text(f"# {command} | {at}\n{output}", encoding="utf-8")
    return output, failure, at


def check(tables: Sequence[pages.Block], seconds: float, *, writing: bool = False, outputs: Path | None = None) -> bool:
    """Run, compare, report; whether all agree."""
    commands = dict.fromkeys(t.measurement.command for t in tables if t.measurement and t.measurement.command)
    good = True
    for command in commands:
        of_command = [t for t in tables if t.measurement and t.measurement.command == command]
        print(f"{command} …", flush=True)
        output, failure, at = output_of(command, seconds, outputs)
        made_by_hand: list[pages.Block] = []
        for table in of_command:
            assert table.measurement is not None
            empty = "has no rows" if not table.rows else "nothing was printed" if not output.strip() else ""
            stale = [] if empty else stale_rows(table, output)
            good &= not stale and not failure and not empty
            if failure or empty:
                print(f"  {table.place}: FAILED ({failure or empty})", flush=True)
            elif stale:
                count = len({id(row) for row, _ in stale})
                print(f"  {table.place}: STALE, {count} of {len(table.rows)} rows, {table.at}", flush=True)
                alike = [other for other in of_command if other.heading == table.heading]
                if writing and pages.write(pages.reread(table), output, (alike.index(table), len(alike))):
                    print("    written: look at the text around it", flush=True)
                    pages.stamp(pages.reread(table), at)
                    continue
                made_by_hand.append(table)
                for row, measured in stale[:OFFERED]:
                    print(f"    docs:    {row.text}\n    printed: {measured}")
            else:
                print(f"  {table.place}: as printed", flush=True)
                if writing:
                    pages.stamp(pages.reread(table), at)
        if writing and made_by_hand:
            pages.replace_all([pages.reread(table) for table in made_by_hand], output, at)
            print("    replaced by what was printed: look at the text around it", flush=True)
    for table in pages.all_blocks(pages.ROOT) if writing else ():
        if table.measurement is not None and not table.measurement.command and table.page in {t.page for t in tables}:
            pages.stamp(pages.reread(table), "")
    return good


def main() -> int:
    """Check the tables; 1 where one is stale."""
    assert __doc__ is not None
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("words", nargs="*", metavar="WORD", help="pages or commands; all if absent")
    parser.add_argument("--list", action="store_true", help="show the tables and their commands, and run nothing")
    parser.add_argument("--write", action="store_true", help="put printed rows in the place of stale ones where it can")
    parser.add_argument("--outputs", type=Path, metavar="FOLDER", help="keeps what commands print, for later calls")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="time limit of a command")
    arguments = parser.parse_args()
    try:
        tables = chosen(pages.all_blocks(pages.ROOT), arguments.words)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    if arguments.list:
        show_list(tables)
    good = arguments.list or check(tables, arguments.seconds, writing=arguments.write, outputs=arguments.outputs)
    if not arguments.list:
        show_list([table for table in tables if table.measurement is None])
    lost = missing_commits(chosen(pages.all_blocks(pages.ROOT), arguments.words))
    print(*lost, sep="\n", end="\n" if lost else "")
    return 0 if good and not lost else 1


if __name__ == "__main__":
    sys.exit(main())
