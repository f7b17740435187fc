"""The command `dynid`, called in the tests' own process."""

from __future__ import annotations

import sys

import pytest

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
