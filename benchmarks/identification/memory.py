"""How much memory the reduction of 2,000,000 samples needs beyond them: a process of its own, its resident set read.

`python -m benchmarks.identification.memory 2000000` is that process; it prints the growth in MB and the seconds.
"""

from __future__ import annotations

import contextlib
import ctypes
import re
import subprocess
import sys
import time
from pathlib import Path

from benchmarks.arm import arm, data
from benchmarks.identification.parameters import ours
from ident.model.base_parameters import base_parameters

COMPARED = """\
memory_growth_mb_2m: highest resident set during the reduction and the solution of 2,000,000 samples, minus the
  resident set with the samples (400 MB) in memory, in a process of its own; 1 MB is 10⁶ bytes."""


def run(count: int = 2_000_000) -> dict[str, float]:
    """Start the process and read what it prints.

    Raises:
        subprocess.CalledProcessError: it failed; its standard error says why.
    """
    command = [sys.executable, "-m", "benchmarks.identification.memory", str(count)]
    growth, seconds = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout.split()
    return {"memory_growth_mb_2m": float(growth), "parameters_2m_seconds": float(seconds)}


def measure(count: int) -> tuple[float, float]:
    """Growth [MB] and wall time [s] of one reduction and solution."""
    model = arm()
    columns = base_parameters(model).columns
    samples = data(model, count)
    # What the preparation left free in the allocator would be reused unseen: give it back to the system.
    ctypes.CDLL(None).malloc_trim(0)
    before = _kilobytes("VmRSS")
    with contextlib.suppress(OSError):  # refused in some containers: the old peak then makes the growth too high
        Path("/proc/self/clear_refs").write_text("5")
    start = time.perf_counter()
    ours(model, columns, samples)
    seconds = time.perf_counter() - start
    return (_kilobytes("VmHWM") - before) * 1024 / 1e6, seconds


def _kilobytes(name: str) -> int:
    found = re.search(rf"^{name}:\s+(\d+) kB", Path("/proc/self/status").read_text(), re.MULTILINE)
    if found is None:
        raise RuntimeError(f"/proc/self/status has no {name}: this benchmark needs Linux")
    return int(found[1])


if __name__ == "__main__":
    print(*measure(int(sys.argv[1])))
