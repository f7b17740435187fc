"""Equations of the pages as MathML, which browsers draw without a script, and public names with their homes.

Equations are LaTeX: $$ … $$ on lines of their own, and $ … $. `::: dynid.NAME` becomes its module: the
public names are imported lazily, which mkdocstrings cannot follow.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert

import dynid

_CODE = re.compile(r"(^```.*?^```|`[^`\n]*`)", re.MULTILINE | re.DOTALL)
_BLOCK = re.compile(r"^\$\$\n(.+?)\n\$\$$", re.MULTILINE | re.DOTALL)
_NAME = re.compile(r"^::: dynid\.(\w+)$", re.MULTILINE)
_INLINE = re.compile(r"\$(?![\s$])([^$\n]*[^\s$])\$(?!\d)")


def on_config(config: Any) -> Any:
    """The settings, with pages that mkdocs.yml does not place in a part of their own."""
    folder = Path(config["docs_dir"])
    placed = Path(config["config_file_path"]).read_text(encoding="utf-8")
    pages = sorted(str(page.relative_to(folder)) for page in folder.glob("**/*.md"))
    if others := [page for page in pages if f": {page}\n" not in placed]:
        config["nav"].append({"More": others})
    return config


def on_page_markdown(markdown: str, **_: Any) -> str:
    """The page with MathML in place of LaTeX; code is left as it is."""
    parts = _CODE.split(markdown)
    parts[::2] = [_converted(text) for text in parts[::2]]
    named = {match[1] for match in _NAME.finditer(markdown)}
    others = "\n\n".join(f"::: dynid.{name}" for name in dir(dynid) if name not in named)
    markdown = "".join(parts).replace("<!-- every other public name -->", others)
    return _NAME.sub(lambda match: f"::: {getattr(dynid, match[1]).__module__}.{match[1]}", markdown)


def _converted(text: str) -> str:
    text = _BLOCK.sub(lambda match: f'<div class="equation">{convert(match[1], display="block")}</div>', text)
    # In a span: a line that begins with <math> would end the paragraph.
    return _INLINE.sub(lambda match: f"<span>{convert(match[1])}</span>", text)
