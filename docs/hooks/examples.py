"""Docstrings' `Example:` as the section that mkdocstrings sets as code."""

from __future__ import annotations

from typing import Any

import griffe


class Examples(griffe.Extension):
    """Called for every object whose docstring is shown."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rename the section."""
        if obj.docstring is not None:
            obj.docstring.value = obj.docstring.value.replace("Example:\n", "Examples:\n")
