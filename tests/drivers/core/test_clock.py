"""Threads are made in one place, which notes what broke them."""

from __future__ import annotations

import ast
import importlib
from pathlib import Path

import pytest
from simulated_clock import SimulatedClock

from drivers.core.clock import Clock

WAITS_FOR_NOTHING = {
    "drivers/core/clock.py",  # the one place
    "drivers/core/child_process.py",  # waits for the end of a process
    "daq/session/realtime.py",  # is joined at once
    "sim_drivers/serving.py",  # reads what is typed, with errors of its own
    "sim_drivers/simulated_arm.py",  # waits for one line of a process
}


def test_what_breaks_a_thread_is_told_once(clock: SimulatedClock) -> None:
    def work(number: int) -> None:
        raise KeyError(number)

    for number in (1, 2):
        thread = clock.thread(work, f"worker {number}", (number,))
        thread.start()
        thread.join()
    assert [str(one) for one in clock.breakdowns()] == [
        "the thread 'worker 1' broke: KeyError: 1",
        "the thread 'worker 2' broke: KeyError: 2",
    ]
    assert clock.breakdowns() == []


@pytest.mark.realtime
def test_a_thread_of_the_system_breaks_without_a_traceback(capfd: pytest.CaptureFixture[str]) -> None:
    clock = Clock()
    thread = clock.thread(lambda: [][0], "worker")
    thread.start()
    thread.join()
    (breakdown,) = clock.breakdowns()
    assert breakdown.thread == "worker"
    assert isinstance(breakdown.error, IndexError)
    assert capfd.readouterr().err == ""


def test_no_other_module_makes_threads() -> None:
    made = set()
    for package in ("drivers", "daq", "ident", "sim_drivers"):
        root = Path(str(importlib.import_module(package).__file__)).parent
        for path in root.rglob("*.py"):
            text = path.read_text()
            for node in ast.walk(ast.parse(text)) if "Thread" in text or "_thread" in text else ():
                if isinstance(node, ast.Call) and ast.unparse(node.func) in ("threading.Thread", "Thread", "_thread"):
                    made.add(f"{package}/{path.relative_to(root)}")
    assert made == WAITS_FOR_NOTHING
