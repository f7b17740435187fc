"""What Tab completes: robots by name and by file, recordings, trajectories and models; imports nothing that is slow."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

BUILTIN_FOLDER = Path(__file__).parents[1] / "robot" / "builtin"


def _files(*suffixes: str) -> Callable[[str], list[str]]:
    """Completes paths of files with a suffix, and of folders on the way there."""

    def complete(incomplete: str) -> list[str]:
        head = incomplete[: incomplete.rfind("/") + 1]
        matches = []
        with suppress(OSError):
            for entry in os.scandir(head or "."):
                path, folder = head + entry.name, entry.is_dir()
                wanted = (folder or entry.name.endswith(suffixes)) and not entry.name.startswith((".", "-"))
                if wanted and path.startswith(incomplete):
                    matches.append(f"{path}/" if folder else path)
        return sorted(matches)

    return complete


def _robots(incomplete: str) -> list[str]:
    """Completes built-in names, then robot files."""
    names = sorted(path.stem for path in BUILTIN_FOLDER.glob("*.yaml"))
    return [name for name in names if name.startswith(incomplete)] + _files(".yaml", ".urdf")(incomplete)


COMPLETIONS: dict[str, Callable[[str], list[str]]] = {
    "robot": _robots,
    **dict.fromkeys(("recordings", "recording", "free", "loaded", "validation"), _files(".h5")),
    **dict.fromkeys(("trajectory", "earlier"), _files(".yaml")),
    **dict.fromkeys(("model", "models", "result", "prior"), _files("result.json")),
}
"""Completions by the name of an argument or option of a command."""
