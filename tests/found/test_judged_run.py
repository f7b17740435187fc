"""What the fuzz suite calls a found case: each thing that no command may do is seen."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

import numpy as np
import pytest
from fuzzing import judged_run
from fuzzing.judged_run import run_command

from dynid import command


def refused() -> None:
    print("dynid: run.h5: is damaged", file=sys.stderr)
    sys.exit(2)


def raising() -> None:
    raise KeyError("a bug")


def crashing() -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def of_two_lines() -> None:
    print("libfoo: cannot parse", file=sys.stderr)
    refused()


def warning() -> None:
    print("RuntimeWarning: overflow", file=sys.stderr)


def of_another_status() -> None:
    sys.exit(3)


def leaving_an_output() -> None:
    Path("out.h5").touch()
    refused()


def changing_an_input() -> None:
    Path("run.h5").write_text("changed")


def colouring() -> None:
    print("\x1b[31m")


def greedy() -> None:
    np.ones(10**7)


@pytest.mark.parametrize(
    ("main", "problem"),
    [
        (refused, ""),
        (raising, "said 'Traceback"),
        (crashing, "was ended by SIGSEGV"),
        (of_two_lines, "2 lines instead of one"),
        (warning, "said 'Warning:'"),
        (of_another_status, "exit status 3"),
        (leaving_an_output, "left out.h5 behind"),
        (changing_an_input, "changed the input run.h5"),
        (colouring, "control characters"),
        (greedy, "GB of memory"),
    ],
)
def test_what_a_command_may_not_do_is_seen(tmp_path: Path, monkeypatch, main, problem: str) -> None:
    folder = tmp_path / "work"
    folder.mkdir()
    (folder / "run.h5").write_text("an input")
    monkeypatch.setattr(command, "main", main)
    if main is greedy:
        monkeypatch.setattr(judged_run, "MEMORY_LIMIT", 8 * 10**7)
    outcome = run_command(["info", "run.h5"], folder)
    assert bool(outcome.problems) == bool(problem)
    assert any(problem in found for found in outcome.problems) or not problem


def test_a_command_that_takes_too_long_is_ended(tmp_path: Path, monkeypatch) -> None:
    def endless() -> None:
        while True:
            pass

    monkeypatch.setattr(command, "main", endless)
    monkeypatch.setattr(judged_run, "CPU_LIMIT", 1)
    (tmp_path / "work").mkdir()
    assert run_command([], tmp_path / "work").problems == (
        "was ended by SIGXCPU",
        "took more than 1 s of processor time",
    )
