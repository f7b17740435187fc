"""The verdict as commands print it first: grades, the reason for each purpose, and what to do next."""

from __future__ import annotations

from collections.abc import Sequence

from daq.commands.console import print_table
from ident.verdict.catalogue import CATALOGUE
from ident.verdict.check import PURPOSE_WORDS
from ident.verdict.verdict import Verdict

MOST_STEPS = 3
"""Remedies that are printed; the others follow with `--verbose` and on the page."""


def print_purposes(verdict: Verdict) -> None:
    """A row for each purpose, or for several of one grade and reason."""
    rows: dict[tuple[str, str], list[str]] = {}
    for purpose, judged in verdict.purposes.items():
        rows.setdefault((judged.grade, judged.because), []).append(PURPOSE_WORDS[purpose])
    print_table(
        "",
        ("purpose", "grade", "because"),
        [(", ".join(words), grade, because) for (grade, because), words in rows.items()],
    )


def next_steps(verdict: Verdict, otherwise: str) -> list[str]:
    """Return what to do next, a line each: remedies of the checks that cost a grade, or else `otherwise`."""
    spoiling = [check for check in verdict.checks if check.severity != "note" and check.name in CATALOGUE]
    names = list(dict.fromkeys(check.name for check in spoiling))
    steps = [f"{CATALOGUE[name].remedy} [{name}]" for name in names[:MOST_STEPS]]
    return steps or [otherwise]


def print_next(steps: Sequence[str], verdict: Verdict, details: str) -> None:
    """What to do next, and where the rest is."""
    print("\nNext:")
    for step in steps:
        print(f"  {step}")
    count = dict.fromkeys(("serious", "warning", "note"), 0)
    for check in verdict.checks:
        count[check.severity] += 1
    raised = ", ".join(f"{number} {severity}" for severity, number in count.items() if number)
    print(f"{f'Checks: {raised}. ' if raised else ''}{details}")


def print_everything(verdict: Verdict) -> None:
    """Headline with reasons, what it rests on, every purpose and joint, every check."""
    for line in verdict.lines:
        print(line)
