"""Writes a driver package under a name of its own: the toy bus of docs/drivers.md, which passes its tests as it is."""

from __future__ import annotations

import re
from importlib.resources import files
from importlib.resources.abc import Traversable
from importlib.util import find_spec
from keyword import iskeyword
from pathlib import Path

from drivers.core.errors import UsageError
from drivers.declaration import installed_drivers

TOY = "toy_bus"
_NAME = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]+)*")


def driver_files(name: str) -> dict[str, str]:
    """Path within the package's folder → text, for a driver of this name.

    Raises:
        UsageError: not a name of a Python module in small letters, or one that is taken.
    """
    hint = "small letters, digits and single underscores, such as my_bus"
    if not _NAME.fullmatch(name) or iskeyword(name):
        raise UsageError(f"'{name}' cannot be the name of a driver", hint=hint)
    if name in installed_drivers():
        raise UsageError(f"a driver is called '{name}' already", hint="choose another name")
    if name != TOY and find_spec(name) is not None:
        raise UsageError(f"a Python module is called '{name}' already", hint="choose another name")
    skeleton = files(__package__) / "skeleton"
    return {_named(path, name): _named(file.read_text(encoding="utf-8"), name) for path, file in _walk(skeleton, "")}


def new_driver(name: str, parent: Path) -> list[Path]:
    """Write the package into the new folder `parent/dynid_name`; returns its files.

    The folder is not called as the package is, or Python, started beside it, would take it for the package.

    Raises:
        UsageError: as `driver_files`, or there is such a folder.
        OSError: it cannot be written.
    """
    texts = driver_files(name)
    folder = parent / f"dynid_{name}"
    if folder.exists():
        raise UsageError("exists already", where=str(folder), hint="choose another name, or another working folder")
    written = [folder / path for path in texts]
    for path, text in zip(written, texts.values(), strict=True):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return written


def _named(text: str, name: str) -> str:
    camel = "".join(word.capitalize() for word in name.split("_"))
    return text.replace(TOY, name).replace("ToyBus", camel)


def _walk(folder: Traversable, place: str) -> list[tuple[str, Traversable]]:
    files: list[tuple[str, Traversable]] = []
    for entry in sorted(folder.iterdir(), key=lambda entry: entry.name):
        if entry.is_dir():
            files += [] if entry.name.startswith(("_", ".")) else _walk(entry, f"{place}{entry.name}/")
        elif not entry.name.endswith(".pyc"):
            files.append((f"{place}{entry.name}", entry))
    return files
