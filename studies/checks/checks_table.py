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
    """The catalogue as a Markdown table per severity, the most serious first (docs/checks.md)."""
    tables = []
    for severity in reversed(SEVERITIES):
        kinds = [kind for kind in CATALOGUE.values() if kind.severity == severity]
        spoiling = any(kind.purposes for kind in kinds)
        lines = [f"### {severity.capitalize()}", "", "| check | meaning | what to do |", "|---|---|---|"]
        if spoiling:
            lines[2:] = ["| check | affects | meaning | what to do |", "|---|---|---|---|"]
        for kind in kinds:
            purposes = "all" if kind.purposes == ALL else ", ".join(PURPOSE_WORDS[purpose] for purpose in kind.purposes)
            cells = [f"`{kind.name}`", *([purposes] if spoiling else []), kind.meaning, kind.remedy]
            lines.append(f"| {' | '.join(cells)} |")
        tables.append("\n".join(lines))
    return "\n\n".join(tables)


def main() -> None:
    """Replace the table."""
    text = PAGE.read_text(encoding="utf-8")
    start = text.index(BEFORE) + len(BEFORE)
    PAGE.write_text(text[:start] + markdown_table() + text[text.index(AFTER, start) :], encoding="utf-8")


if __name__ == "__main__":
    main()
