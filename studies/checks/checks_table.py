"""Write the catalogue of checks into docs/checks.md, between its heading and the one that follows.

python -m studies.checks.checks_table
"""

from __future__ import annotations

from pathlib import Path

from ident.verdict.catalogue import markdown_table

PAGE = Path(__file__).parents[2] / "docs" / "checks.md"
BEFORE, AFTER = "## The catalogue\n\n", "\n\n## "


def main() -> None:
    """Replace the table."""
    text = PAGE.read_text(encoding="utf-8")
    start = text.index(BEFORE) + len(BEFORE)
    PAGE.write_text(text[:start] + markdown_table() + text[text.index(AFTER, start) :], encoding="utf-8")


if __name__ == "__main__":
    main()
