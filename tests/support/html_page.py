"""A page as a browser parses it."""

from __future__ import annotations

import json
from html.parser import HTMLParser
from typing import Any

import pytest


class Page(HTMLParser):
    """Elements with their attributes, the text between them, and the scripts' data: figures and frames by name."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.figures: dict[str, Any] = {}
        self.frames: dict[str, Any] = {}
        self.words = ""
        self._open: tuple[str, dict[str, str | None]] = ("", {})
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._open = (tag, dict(attrs))
        self.elements.append(self._open)

    def handle_endtag(self, tag: str) -> None:
        self._open = ("", {})

    def handle_data(self, data: str) -> None:
        tag, attributes = self._open
        if tag == "script":
            for store, key in ((self.figures, "data-figure"), (self.frames, "data-frames")):
                if name := attributes.get(key):
                    # JSON.parse in a browser knows no NaN, either.
                    store[name] = json.loads(data, parse_constant=lambda constant: pytest.fail(constant))
        elif tag != "style":
            self.words += data

    def ids(self) -> list[str]:
        return [name for _, attributes in self.elements if (name := attributes.get("id"))]

    def traces(self, figure: str, name: str) -> list[dict[str, Any]]:
        return [trace for trace in self.figures[figure]["data"] if trace["name"] == name]
