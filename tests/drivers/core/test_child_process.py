"""Processes of dynid's own, started from a script as a user writes it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """
import multiprocessing
from drivers.core.child_process import started_without_interrupt
print("the script", flush=True)
process = multiprocessing.get_context("{method}").Process(target=print, args=("the process",))
with started_without_interrupt():
    process.start()
process.join()
print(process.exitcode, flush=True)
"""


@pytest.mark.parametrize("method", ["spawn", "forkserver"])
def test_a_process_does_not_run_an_unguarded_script_again(tmp_path: Path, method: str) -> None:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.format(method=method))
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=60)
    assert (done.stdout, done.stderr) == ("the script\nthe process\n0\n", "")
