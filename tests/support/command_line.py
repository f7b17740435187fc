"""The command `dynid`, called in the tests' own process."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from daq.output_files import GENERATION_KEY, OWN_HASH
from dynid import command


def run(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *arguments: object
) -> tuple[int, str, str]:
    """Exit status, standard output, standard error."""
    monkeypatch.setattr(sys, "argv", ["dynid", *map(str, arguments)])
    with pytest.raises(SystemExit) as stopped:
        command.main()
    captured = capsys.readouterr()
    return int(stopped.value.code or 0), captured.out, captured.err


def stored(path: Path) -> dict[str, Any]:
    """The object of a JSON file, without its hash and those of the files written with it."""
    content = json.loads(path.read_text(encoding="utf-8"))
    return {key: value for key, value in content.items() if key not in (OWN_HASH, GENERATION_KEY)}
