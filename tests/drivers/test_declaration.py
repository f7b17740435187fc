"""What drivers declare is there, is found by it alone, and no bus is named outside its own folders."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from drivers import declaration
from drivers.core.errors import UsageError
from drivers.declaration import declared, installed_drivers, named

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGES = ("drivers", "daq", "ident", "sim_drivers", "dynid")
ROOMS = {"core", "can", "plant", "serving", "synthetic", "conformance", "new_driver"}
"""Folders of drivers/ and sim_drivers/ that several buses share."""
LIBRARIES = {("drivers/can/bus.py", "slcan"), ("drivers/can/bus.py", "can")}
"""An interface of python-can, and the library's own logger."""
FAULTS = "sim_drivers/faults.py"
"""One table of faults for all servers, which are named there in words."""


def own_folders() -> list[Path]:
    rooms = [path.parent for root in ("drivers", "sim_drivers") for path in (REPOSITORY / root).glob("*/__init__.py")]
    return [room for room in rooms if room.name not in ROOMS]


def modules_outside(words: set[str]) -> Iterator[tuple[str, ast.Module]]:
    """Modules outside of the buses' own folders that have one of these words, as a text or in an import."""
    own, some = own_folders(), "|".join(sorted(words))
    having = re.compile(rf"""["']({some})["']|drivers\.({some})\b""")
    for package in PACKAGES:
        for path in sorted((REPOSITORY / package).rglob("*.py")):
            if not any(path.is_relative_to(folder) for folder in own) and "skeleton" not in path.parts:
                text = path.read_text(encoding="utf-8")
                if having.search(text):
                    yield path.relative_to(REPOSITORY).as_posix(), ast.parse(text)


def test_no_bus_is_named_or_imported_outside_its_own_folders() -> None:
    drivers = {name for name, entry in installed_drivers().items() if entry.value.startswith("drivers.")}
    wires = {back_end.wire for name in drivers for back_end in declared(name).simulated}
    folders = {folder.name for folder in own_folders()}
    assert len(folders) >= 4
    words = drivers | wires | folders
    found = []
    for place, module in modules_outside(words):
        for node in ast.walk(module):
            if isinstance(node, ast.Constant) and node.value in words:
                found.append((place, str(node.value)))
            parts = (node.module or "").split(".") if isinstance(node, ast.ImportFrom) else [""]
            if parts[0] in ("drivers", "sim_drivers") and len(parts) > 1 and parts[1] in folders:
                found.append((place, ".".join(parts)))
    assert {entry for entry in found if entry[0] != FAULTS} - LIBRARIES == {("sim_drivers/commands.py", DEMO)}


DEMO = "sim_drivers.rtde.demo"
"""The command `demo` is the demonstration of one bus."""


def test_everything_that_is_declared_can_be_imported() -> None:
    words: list[str] = []
    for name in installed_drivers():
        found = declared(name)
        for place in (found.driver, found.budget, found.advice, found.connection_check):
            assert not place or not isinstance(place, str) or callable(named(place)), (name, place)
        for back_end in found.simulated:
            words.append(back_end.wire)
            for place in filter(None, (back_end.serve, back_end.beside)):
                assert callable(named(place)), (name, place)
    assert len(set(words)) == len(words)


def test_what_is_no_declaration_is_an_error_of_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken() -> object:
        raise ImportError("no module named 'gone'")

    entries = [
        SimpleNamespace(name="old", value="my.bus:MyDriver", load=lambda: SimpleNamespace),
        SimpleNamespace(name="broken", value="my.bus:MyDriver", load=broken),
    ]
    monkeypatch.setattr(declaration, "entry_points", lambda group: entries)
    with pytest.raises(UsageError, match=r"arm.yaml: no driver is called 'x' \(installed: broken, old\)"):
        declared("x", "arm.yaml")
    with pytest.raises(UsageError, match=r"'old' is not a DriverDeclaration \(my.bus:MyDriver is type: pip install"):
        declared("old")
    with pytest.raises(UsageError, match="'broken' cannot be loaded: no module named 'gone'"):
        declared("broken")
