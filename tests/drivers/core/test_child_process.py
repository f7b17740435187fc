"""Processes of dynid's own, started from a script as a user writes it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """
import multiprocessing, os, signal
from drivers.core.child_process import started_without_interrupt
print("the script", flush=True)
process = multiprocessing.get_context("{method}").Process(target=print, args=("the process",))
with started_without_interrupt():
    process.start()
process.join()
print(process.exitcode, flush=True)
mine, other = multiprocessing.Pipe()
process = multiprocessing.get_context("{method}").Process(target=exec, args=({endless!r}, {{"other": other}}))
with started_without_interrupt():
    process.start()
print(mine.recv(), flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""

ENDLESS = """
import signal
from drivers.core.child_process import end_with_parent
end_with_parent()
other.send(7)
signal.pause()
"""


@pytest.mark.parametrize("method", ["spawn", "forkserver"])
def test_a_process_runs_no_unguarded_script_again_and_ends_with_the_one_that_started_it(
    tmp_path: Path, method: str
) -> None:
    """Reading its output ends when the last process has let go of it."""
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.format(method=method, endless=ENDLESS))
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=60)
    assert (done.stdout, done.stderr) == ("the script\nthe process\n0\n7\n", "")
