"""Write the catalogue of checks into docs/checks.md, between its heading and the one that follows.

python -m studies.checks.checks_table
"""

from __future__ import annotations

from pathlib import Path

from ident.verdict.catalogue import ALL, CATALOGUE
from ident.verdict.check import PURPOSE_WORDS, SEVERITIES

PAGE = Path(__file__).parents[2] / "docs" / "checks.md"
BEFORE, AFTER = "## The catalogue\n\n", "\n\n## "


def markdown_table() -> str:
    """The catalogue as a table in Markdown, the most serious checks first (docs/checks.md)."""
    ordered = sorted(CATALOGUE.values(), key=lambda kind: -SEVERITIES.index(kind.severity))
    lines = ["| check | severity | spoils | meaning | what to do |", "|---|---|---|---|---|"]
    for kind in ordered:
        spoilt = "all" if kind.purposes == ALL else ", ".join(PURPOSE_WORDS[purpose] for purpose in kind.purposes)
        lines.append(f"| `{kind.name}` | {kind.severity} | {spoilt or '–'} | {kind.meaning} | {kind.remedy} |")
    return "\n".join(lines)


def main() -> None:
    """Replace the table."""
    text = PAGE.read_text(encoding="utf-8")
    start = text.index(BEFORE) + len(BEFORE)
    PAGE.write_text(text[:start] + markdown_table() + text[text.index(AFTER, start) :], encoding="utf-8")


if __name__ == "__main__":
    main()
