"""Write the catalogue of checks into docs/checks.md, between its heading and the one that follows.

python -m studies.checks.checks_table
"""

from __future__ import annotations

from itertools import groupby
from pathlib import Path

from ident.verdict.catalogue import CATALOGUE
from ident.verdict.check import ALL, PURPOSE_WORDS, PURPOSES, SEVERITIES

PAGE = Path(__file__).parents[2] / "docs" / "checks.md"
BEFORE, AFTER = "## The catalogue\n\n", "\n\n## "


def markdown_lists() -> str:
    """The catalogue as Markdown lists per severity, the most serious first, and per purposes (docs/checks.md)."""
    paragraphs = []
    for severity in reversed(SEVERITIES):
        paragraphs.append(f"### {severity.capitalize()}")
        kinds = [kind for kind in CATALOGUE.values() if kind.severity == severity]
        kinds.sort(key=lambda kind: (-len(kind.purposes), [PURPOSES.index(purpose) for purpose in kind.purposes]))
        for purposes, group in groupby(kinds, key=lambda kind: kind.purposes):
            if purposes:
                words = "all purposes" if purposes == ALL else ", ".join(PURPOSE_WORDS[one] for one in purposes)
                paragraphs.append(f"For {words}:")
            paragraphs.append("\n".join(f"- **`{kind.name}`**: {kind.meaning}. {kind.remedy}" for kind in group))
    return "\n\n".join(paragraphs)


def main() -> None:
    """Replace the lists."""
    text = PAGE.read_text(encoding="utf-8")
    start = text.index(BEFORE) + len(BEFORE)
    PAGE.write_text(text[:start] + markdown_lists() + text[text.index(AFTER, start) :], encoding="utf-8")


if __name__ == "__main__":
    main()
